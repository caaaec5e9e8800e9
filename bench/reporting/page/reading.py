"""Stored cells by scenario: what was asked, of which system, and which experiments' tables show it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from bench.config.drawn import drawn_scenarios
from bench.config.experiment import Experiment
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
from bench.store.store import Store

DERIVED = ("natural_frequency", "damping_ratio")
"""Quantities that say the same as k/m and c/m once more; they are in the CSVs."""
SIZES = {
    "integrator": "relative tolerance {:g}", "jitter": "{:g} of a step", "irregular": "",
    "coloured": "correlation {:g}", "heavy_tails": "{:g} degrees of freedom", "outliers": "{:g} × the noise",
    "bias": "{:g} of the signal’s rms", "drift": "{:g} of the signal’s rms at the end", "late_trigger": "{:g} s",
}  # fmt: skip
"""What the size of a disturbance is, by kind; of others the bare number is shown."""


def disturbed(kind: str, size: float) -> str:
    """A disturbance and its size with the unit."""
    said = "" if math.isnan(size) else SIZES.get(kind, "{:g}").format(size)
    return (f"{kind}, {said}" if said else kind).replace("_", " ")


def decibels(snr_db: float) -> str:
    """A signal-to-noise ratio to a tenth of a decibel."""
    return f"{round(snr_db, 1):g}"


@dataclass(frozen=True)
class TableOfExperiment:
    """An experiment that describes a table: its name in ``conf``, the table's number if any, its scenarios' keys."""

    name: str
    number: int | None
    scenarios: frozenset[str]

    @property
    def short(self) -> str:
        """The number of its table, else its name."""
        return self.name if self.number is None else str(self.number)

    @property
    def said(self) -> str:
        """``Table 3``, else the name."""
        return self.name if self.number is None else f"Table {self.number}"


@dataclass(frozen=True)
class ScenarioPanel:
    """All that is stored of one scenario and seed: one result a label, methods and reference rows alike."""

    results: tuple[Result, ...]
    experiments: tuple[TableOfExperiment, ...]

    @property
    def facts(self) -> Result:
        """What all share: any of the results."""
        return self.results[0]

    @property
    def disturbance(self) -> str:
        """What breaks the assumptions; empty where nothing does."""
        facts = self.facts
        return disturbed(facts.disturbance, facts.disturbance_size) if facts.disturbance else ""

    @property
    def kind(self) -> str:
        """What is special about its data, in a few words."""
        facts = self.facts
        drawn = "truth drawn anew" if facts.truth_drawn else ""
        prior = "no prior" if facts.prior is None else "wrong prior" if facts.prior.get("wrong") else ""
        parts = [self.disturbance, drawn, prior, f"seed {facts.seed}" if facts.seed else ""]
        return ", ".join(part for part in parts if part) or "undisturbed"

    @property
    def plain(self) -> bool:
        """Neither disturbed nor with a truth of its own in each replicate."""
        return not self.facts.disturbance and not self.facts.truth_drawn

    @cached_property
    def methods(self) -> tuple[Result, ...]:
        """The results of methods; reference rows left out."""
        return tuple(result for result in self.results if not result.is_reference)

    @cached_property
    def metrics(self) -> tuple[str, ...]:
        """Errors of parameters and groups, and the displacement's, in the order in which the results have them."""
        names = dict.fromkeys(name for result in self.results for name in result.summary)
        errors = [n for n in names if n.endswith(ERROR) and not n.startswith(DERIVED)]
        return (*errors, *(["rmse"] if "rmse" in names else []))

    @cached_property
    def ranked(self) -> tuple[str, ...]:
        """The metrics that the data decide: what methods can be compared on. Groups first where parameters are not."""
        told = self.identifiable
        return tuple(name for name in self.metrics if name == "rmse" or told.get(name.removesuffix(ERROR), True))

    @cached_property
    def identifiable(self) -> Mapping[str, bool]:
        """By quantity, whether the data alone tell it."""
        return {name: told for result in reversed(self.results) for name, told in result.identifiable.items()}

    @cached_property
    def prior_share(self) -> Mapping[str, float]:
        """By quantity, the prior's share of the variance at the bound."""
        return {name: share for result in reversed(self.results) for name, share in result.prior_share.items()}

    def title(self) -> str:
        """One line for people."""
        special = "" if self.kind == "undisturbed" else f", {self.kind}"
        facts = self.facts
        return f"{facts.system}, {decibels(facts.snr_db)} dB, initial state {facts.initial_state}{special}"


@dataclass(frozen=True)
class StoreReading:
    """The store as the page needs it; ``hidden`` results gave way to others of the same label and scenario.

    ``hidden``: how many times each such label and scenario is there, as text. ``drawn`` are the results of the
    scenarios that experiments draw, which have no page each.
    """

    panels: tuple[ScenarioPanel, ...]
    results: tuple[Result, ...]
    experiments: tuple[TableOfExperiment, ...]
    hidden: Mapping[str, int]
    drawn: tuple[Result, ...] = ()


def read(store: Store) -> StoreReading:
    """Read a store; raises InputError where there is none, where it is empty, or for a file that is no cell.

    Scenarios that were drawn, hundreds with one data set each, say something together only: they are left to their
    table. So are the variants of a family, dozens of one method.
    """
    described = [_table(name) for name in table_experiments() if not drawn_scenarios(name)]
    stored = [result for result in stored_results(store) if not is_variant(result)]
    results = [result for result in stored if result.question not in drawn_questions()]
    drawn = tuple(result for result in stored if result.question in drawn_questions())
    grouped = group(results, lambda result: result.question)
    found = [one for one in described if one.scenarios & set(grouped)]
    experiments = tuple(sorted(found, key=lambda one: (one.number is None, one.number or 0, one.name)))
    panels = [_panel(own, [one for one in experiments if key in one.scenarios]) for key, own in grouped.items()]
    panels.sort(key=_order(experiments))
    shown = {result for panel in panels for result in panel.results}
    hidden = Counter(f"{one.title} ({ScenarioPanel((one,), ()).title()})" for one in results if one not in shown)
    return StoreReading(tuple(panels), tuple(results), experiments, hidden, drawn)


def _table(name: str) -> TableOfExperiment:
    """What an experiment describes."""
    number = Experiment(name).table.get("number")
    return TableOfExperiment(name, None if number is None else int(number), questions(name))


def _panel(results: Sequence[Result], experiments: Sequence[TableOfExperiment]) -> ScenarioPanel:
    """Of several results of a label, the one of most replicates."""
    chosen: dict[str, Result] = {}
    for result in sorted(results, key=lambda one: (-one.n, one.identity)):
        chosen.setdefault(result.label, result)
    return ScenarioPanel(tuple(chosen[label] for label in sorted(chosen)), tuple(experiments))


def _order(experiments: Sequence[TableOfExperiment]) -> Any:
    """Tables, other experiments, single cells; then by system, less noise first, start unknown first."""
    rank = {one.name: i for i, one in enumerate(experiments)}

    def key(panel: ScenarioPanel) -> tuple[Any, ...]:
        places = [rank[one.name] for one in panel.experiments]
        first, facts = min(places, default=len(rank)), panel.facts
        unknown_first = facts.initial_state != "unknown"
        return first, bool(panel.disturbance), facts.system, -facts.snr_db, unknown_first, facts.question

    return key
