"""Stored cells by scenario, and the tables that show them: what every page of the site is made of."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from bench.config.random_scenarios import drawn_scenarios
from bench.reporting.family import is_variant
from bench.reporting.frame import (
    ERROR,
    Result,
    drawn_questions,
    group,
    questions,
    stored_results,
    table_experiments,
)
from bench.reporting.page.words import (
    decibels,
    disturbed,
    hashed,
    prior_words,
    slug,
    system_words,
    table_number,
    true_values,
)
from bench.store.store import Store

DERIVED = ("natural_frequency", "damping_ratio")
"""Quantities that say the same as k/m and c/m once more; they are in the CSVs."""


@dataclass(frozen=True, eq=False)
class ScenarioPanel:
    """All that is stored of one scenario and seed: one result a label, methods and reference rows alike.

    ``experiments`` are those that describe a table with it, ``slug`` is its permanent address, ``title`` says what it
    is in a line that no other has.
    """

    results: tuple[Result, ...]
    experiments: tuple[str, ...] = ()
    slug: str = ""
    title: str = ""

    @property
    def facts(self) -> Result:
        """What all share: any of the results."""
        return self.results[0]

    @property
    def disturbance(self) -> str:
        """What breaks the assumptions; empty where nothing does."""
        return disturbed(self.facts.disturbance, self.facts.disturbance_size)

    @property
    def kind(self) -> str:
        """What is special about its data, in a few words."""
        facts = self.facts
        drawn = "truth drawn anew" if facts.truth_drawn else ""
        prior = "no prior" if facts.prior is None else "wrong prior" if facts.prior.get("wrong") else ""
        parts = [self.disturbance, drawn, prior, f"seed {facts.seed}" if facts.seed else ""]
        return ", ".join(filter(None, parts)) or "undisturbed"

    @property
    def plain(self) -> bool:
        """Neither disturbed nor with a truth of its own in each replicate."""
        return not self.facts.disturbance and not self.facts.truth_drawn

    @cached_property
    def methods(self) -> tuple[Result, ...]:
        """The results of methods; reference rows left out."""
        return tuple(result for result in self.results if not result.is_reference)

    @property
    def most_sets(self) -> int:
        """The data sets of the method that has most."""
        return max((result.n for result in self.methods), default=0)

    @cached_property
    def metrics(self) -> tuple[str, ...]:
        """Errors of parameters and groups, and the displacement's, in the order in which the results have them."""
        names = dict.fromkeys(name for result in self.results for name in result.summary)
        errors = [name for name in names if name.endswith(ERROR) and not name.startswith(DERIVED)]
        return (*errors, *(["rmse"] if "rmse" in names else []))

    @cached_property
    def ranked(self) -> tuple[str, ...]:
        """The metrics that the data decide: what methods can be compared on."""
        return tuple(name for name in self.metrics if self.identifiable.get(name.removesuffix(ERROR), True))

    @cached_property
    def identifiable(self) -> Mapping[str, bool]:
        """By quantity, whether the data alone tell it."""
        return {name: told for result in reversed(self.results) for name, told in result.identifiable.items()}

    @cached_property
    def prior_share(self) -> Mapping[str, float]:
        """By quantity, the prior's share of the variance at the bound."""
        return {name: share for result in reversed(self.results) for name, share in result.prior_share.items()}

    def bound(self, metric: str) -> float:
        """The bound on the root mean square of a metric; that of any result that has one."""
        return next((result.bound(metric) for result in self.results if metric in result.summary), float("nan"))


@dataclass(frozen=True)
class StoreReading:
    """What the site shows of a store.

    ``stored`` are all of its results, ``drawn`` those of drawn scenarios, which have no page each; ``hidden`` counts
    those that gave way to others of the same label and scenario, by title.
    """

    panels: tuple[ScenarioPanel, ...]
    stored: tuple[Result, ...]
    drawn: tuple[Result, ...]
    hidden: Mapping[str, int]


def read(store: Store) -> StoreReading:
    """Read a store; raises InputError where there is none, where it is empty, or for a file that is no cell.

    Scenarios that were drawn, hundreds with one data set each, say something together only: they are left to their
    table. So are the variants of a family, dozens of one method.
    """
    stored = stored_results(store)
    drawn = [result for result in stored if result.question in drawn_questions()]
    results = [result for result in stored if result.question not in drawn_questions() and not is_variant(result)]
    grouped = group(results, lambda result: result.question)
    tables = {name: questions(name) for name in table_experiments() if not drawn_scenarios(name)}
    order = sorted(tables, key=lambda name: (table_number(name), name))
    panels = [_panel(own, [name for name in order if key in tables[name]]) for key, own in grouped.items()]
    panels.sort(key=lambda panel: _order(panel, order))
    panels = named(panels)
    shown = {result.identity for panel in panels for result in panel.results}
    title = {panel.facts.question: panel.title for panel in panels}
    gone = (f"{one.title} ({title[one.question]})" for one in results if one.identity not in shown)
    return StoreReading(tuple(panels), tuple(stored), tuple(drawn), Counter(gone))


def _panel(results: Sequence[Result], experiments: Sequence[str]) -> ScenarioPanel:
    """Of several results of a label, the one of most replicates."""
    fewest_first = sorted(results, key=lambda one: (-one.n, one.identity), reverse=True)
    chosen = {result.label: result for result in fewest_first}
    return ScenarioPanel(tuple(chosen[label] for label in sorted(chosen)), tuple(experiments))


def _order(panel: ScenarioPanel, tables: Sequence[str]) -> Any:
    """Tables, other experiments, single cells; then by system, less noise first, start unknown first."""
    facts, first = panel.facts, tables.index(panel.experiments[0]) if panel.experiments else len(tables)
    known = facts.initial_state != "unknown"
    return first, bool(panel.disturbance), facts.system, -facts.snr_db, known, facts.question


def named(panels: Iterable[ScenarioPanel]) -> list[ScenarioPanel]:
    """Scenarios with their titles and permanent addresses, which a link may outlive new results with.

    An address is of system, noise, start and what is special; where another scenario has that already, it ends with a
    hash of the whole question. Panels come in the order of the tables, so that a scenario of a table keeps the plain
    address. Scenarios of the same title have in it what tells them apart.
    """
    taken: dict[str, str] = {}
    for panel in panels:
        facts, special = panel.facts, "" if panel.kind == "undisturbed" else f" {panel.kind}"
        special = re.sub(r"[^\w .,-]+", "", special, flags=re.ASCII)
        plain = slug(f"{facts.system} {decibels(facts.snr_db)}db start {facts.initial_state}{special}")
        taken[facts.question] = hashed(plain, facts.question) if plain in taken.values() else plain
    alike = group(panels, _title)
    titles = {panel.facts.question: text for title, own in alike.items() for panel, text in _told_apart(title, own)}
    return [replace(panel, slug=taken[(key := panel.facts.question)], title=titles[key]) for panel in panels]


def _title(panel: ScenarioPanel) -> str:
    facts, special = panel.facts, "" if panel.kind == "undisturbed" else f"; {panel.kind}"
    return f"{system_words(facts)}, {decibels(facts.snr_db)} dB, initial state {facts.initial_state}{special}"


def _told_apart(title: str, panels: Sequence[ScenarioPanel]) -> Iterable[tuple[ScenarioPanel, str]]:
    """Scenarios of one title: the first with the title alone, others with those of their facts in which they differ."""

    def facts(one: Result) -> tuple[str, str, str]:
        length = f"{one.samples} samples in {one.duration:g} s"
        return length, true_values(one), f"prior: {prior_words(one)}"

    usual = facts(panels[0].facts)
    for panel in panels:
        special = [text for text, first in zip(facts(panel.facts), usual, strict=True) if text != first]
        yield panel, "; ".join((title, *special))
