"""Read a store for the site: stored cells by scenario, with the tables that show them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from bench.config.random_scenarios import drawn_scenarios
from bench.reporting.family import is_variant
from bench.reporting.frame import ERROR, Result, drawn_questions, group, questions, stored_results, table_experiments
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
"""Quantities that follow from k/m and c/m; they are in the CSV files alone."""


@dataclass(frozen=True, eq=False)
class ScenarioPanel:
    """The stored results of one scenario and seed, one per label, reference rows included.

    Attributes:
        results: The results.
        experiments: Experiments with a table that contain the scenario.
        slug: Permanent address.
        title: Title, different from those of all other scenarios.
    """

    results: tuple[Result, ...]
    experiments: tuple[str, ...] = ()
    slug: str = ""
    title: str = ""

    @property
    def facts(self) -> Result:
        """One of the results; all share the facts of the scenario."""
        return self.results[0]

    @property
    def disturbance(self) -> str:
        """Disturbance with its size; empty for none."""
        return disturbed(self.facts.disturbance, self.facts.disturbance_size)

    @property
    def kind(self) -> str:
        """Properties that distinguish the data from those of a plain scenario."""
        facts = self.facts
        drawn = "random true values" if facts.truth_drawn else ""
        prior = "no prior" if facts.prior is None else "wrong prior" if facts.prior.get("wrong") else ""
        parts = [self.disturbance, drawn, prior, f"seed {facts.seed}" if facts.seed else ""]
        return ", ".join(filter(None, parts)) or "undisturbed"

    @property
    def plain(self) -> bool:
        """Whether the data are undisturbed and all replicates have the same true values."""
        return not self.facts.disturbance and not self.facts.truth_drawn

    @cached_property
    def methods(self) -> tuple[Result, ...]:
        """Results without those of reference rows."""
        return tuple(result for result in self.results if not result.is_reference)

    @property
    def most_sets(self) -> int:
        """Largest number of data sets of a method."""
        return max((result.n for result in self.methods), default=0)

    @cached_property
    def metrics(self) -> tuple[str, ...]:
        """Error metrics of parameters, groups and displacement, in the order of the results."""
        names = dict.fromkeys(name for result in self.results for name in result.summary)
        errors = [name for name in names if name.endswith(ERROR) and not name.startswith(DERIVED)]
        return (*errors, *(["rmse"] if "rmse" in names else []))

    @cached_property
    def ranked(self) -> tuple[str, ...]:
        """Error metrics of identifiable quantities, on which methods are compared."""
        return tuple(name for name in self.metrics if self.identifiable.get(name.removesuffix(ERROR), True))

    @cached_property
    def identifiable(self) -> Mapping[str, bool]:
        """Whether each quantity is identifiable from the data alone."""
        return {name: value for result in reversed(self.results) for name, value in result.identifiable.items()}

    @cached_property
    def prior_share(self) -> Mapping[str, float]:
        """Share of the bound's variance that is due to the prior, by quantity."""
        return {name: share for result in reversed(self.results) for name, share in result.prior_share.items()}

    def bound(self, metric: str) -> float:
        """Return the bound on the root mean square of a metric, from any result that has one."""
        return next((result.bound(metric) for result in self.results if metric in result.summary), float("nan"))


@dataclass(frozen=True)
class StoreReading:
    """Contents of a store as the site shows them.

    Attributes:
        panels: Scenarios with a page.
        stored: All results.
        drawn: Results of random scenarios, which have no pages.
        hidden: Number of results that are not shown since another of the same label and scenario has more data sets,
            by title.
    """

    panels: tuple[ScenarioPanel, ...]
    stored: tuple[Result, ...]
    drawn: tuple[Result, ...]
    hidden: Mapping[str, int]


def read(store: Store) -> StoreReading:
    """Read a store; raises InputError for a store that is absent or empty, or a file that is no cell.

    Random scenarios (hundreds, with one data set each) and the variants of a family have no pages, only tables.
    """
    stored = stored_results(store)
    drawn = [result for result in stored if result.question in drawn_questions()]
    results = [result for result in stored if result.question not in drawn_questions() and not is_variant(result)]
    grouped = group(results, lambda result: result.question)
    tables = {name: questions(name) for name in table_experiments() if not drawn_scenarios(name)}
    order = sorted(tables, key=lambda name: (table_number(name), name))
    panels = [_panel(members, [name for name in order if key in tables[name]]) for key, members in grouped.items()]
    panels.sort(key=lambda panel: _order(panel, order))
    panels = named(panels)
    shown = {result.identity for panel in panels for result in panel.results}
    title = {panel.facts.question: panel.title for panel in panels}
    hidden = (f"{result.title} ({title[result.question]})" for result in results if result.identity not in shown)
    return StoreReading(tuple(panels), tuple(stored), tuple(drawn), Counter(hidden))


def _panel(results: Sequence[Result], experiments: Sequence[str]) -> ScenarioPanel:
    """Make a panel with the result of most replicates of each label."""
    fewest_first = sorted(results, key=lambda result: (-result.n, result.identity), reverse=True)
    chosen = {result.label: result for result in fewest_first}
    return ScenarioPanel(tuple(chosen[label] for label in sorted(chosen)), tuple(experiments))


def _order(panel: ScenarioPanel, tables: Sequence[str]) -> Any:
    """Return the sort key of a panel: tables first, then system, least noise and unknown initial state first."""
    facts, first = panel.facts, tables.index(panel.experiments[0]) if panel.experiments else len(tables)
    known = facts.initial_state != "unknown"
    return first, bool(panel.disturbance), facts.system, -facts.snr_db, known, facts.question


def named(panels: Iterable[ScenarioPanel]) -> list[ScenarioPanel]:
    """Give scenarios their titles and permanent addresses, which new results do not change.

    An address consists of system, noise, initial state and special properties; if another scenario has the same, it
    ends with a hash of the question. Panels are in the order of the tables, so a scenario of a table keeps the plain
    address. Titles that would be equal are extended by the facts that differ.
    """
    taken: dict[str, str] = {}
    for panel in panels:
        facts, special = panel.facts, "" if panel.kind == "undisturbed" else f" {panel.kind}"
        special = re.sub(r"[^\w .,-]+", "", special, flags=re.ASCII)
        plain = slug(f"{facts.system} {decibels(facts.snr_db)}db start {facts.initial_state}{special}")
        taken[facts.question] = hashed(plain, facts.question) if plain in taken.values() else plain
    by_title = group(panels, _title)
    titles = {panel.facts.question: text for name, same in by_title.items() for panel, text in _distinct(name, same)}
    return [replace(panel, slug=taken[(key := panel.facts.question)], title=titles[key]) for panel in panels]


def _title(panel: ScenarioPanel) -> str:
    facts, special = panel.facts, "" if panel.kind == "undisturbed" else f"; {panel.kind}"
    return f"{system_words(facts)}, {decibels(facts.snr_db)} dB, initial state {facts.initial_state}{special}"


def _distinct(title: str, panels: Sequence[ScenarioPanel]) -> Iterable[tuple[ScenarioPanel, str]]:
    """Extend the title of all but the first of some scenarios by the facts in which they differ from it."""

    def facts(result: Result) -> tuple[str, str, str]:
        length = f"{result.samples} samples in {result.duration:g} s"
        return length, true_values(result), f"prior: {prior_words(result)}"

    usual = facts(panels[0].facts)
    for panel in panels:
        special = [text for text, first in zip(facts(panel.facts), usual, strict=True) if text != first]
        yield panel, "; ".join((title, *special))
