"""Situations that a user has before him, and the ranking of methods over all stored scenarios of each.

A situation is a predicate over scenarios; its ranking is that of :mod:`bench.reporting.ranking` over every stored
scenario, noise level and start that it names.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bench.reporting.frame import Result, group
from bench.reporting.page.reading import ScenarioPanel
from bench.reporting.ranking import Ranked, ranking

HOPELESS = 0.5
"""No method is advised where each of the first tier loses more than this share of its fits."""
FEWEST_SETS = 20
"""Scenarios with fewer data sets a method are studies of reach, and tell no risk."""
FEWEST_METHODS = 0.5
"""Scenarios with less than this share of the situation's methods are studies of a few, and compare no others."""


@dataclass(frozen=True)
class Situation:
    """What a user has before him: a name for addresses, words, and which scenarios are of that kind."""

    name: str
    words: str
    has: Callable[[ScenarioPanel], bool]


@dataclass(frozen=True)
class Advice:
    """The methods of some scenarios as they are ranked; ``href`` is the page about them."""

    words: str
    href: str
    results: tuple[Result, ...]
    panels: tuple[ScenarioPanel, ...] = ()

    @cached_property
    def ranking(self) -> list[Ranked]:
        return ranking(self.results)

    @property
    def first_tier(self) -> list[Ranked]:
        return [row for row in self.ranking if row.tier == 1]

    @property
    def hopeless(self) -> bool:
        """Whether all that could be advised lose most of their fits: then none is."""
        return not any(row.lost <= HOPELESS * row.fits for row in self.first_tier)

    @cached_property
    def seconds(self) -> dict[str, float]:
        """By method, the median processor time (s) of a fit that gave an answer; NaN without any."""
        return {label: median_seconds(its) for label, its in group(self.results, lambda result: result.label).items()}

    @property
    def fastest(self) -> Ranked:
        """The fastest method of the first tier."""
        return min(self.first_tier, key=lambda row: (np.nan_to_num(self.seconds[row.label], nan=np.inf), row.label))


def median_seconds(results: Sequence[Result]) -> float:
    """The median over scenarios of the median processor time (s) of a fit that gave an answer; NaN without any."""
    medians = [float(np.median(result.cpu_s[result.ok])) for result in results if result.n_ok]
    known = [value for value in medians if np.isfinite(value)]
    return float(np.median(known)) if known else np.nan


def _linear(panel: ScenarioPanel, masses: int) -> bool:
    model = panel.facts.known_model
    return model is not None and model.linear and (model.n_dof == 1) == (masses == 1) and not model.n_hidden


def _free(panel: ScenarioPanel) -> bool:
    return panel.plain and not panel.facts.forced and not panel.facts.added_mass


def _regime(panel: ScenarioPanel) -> bool:
    return "regimes" in {one.name for one in panel.experiments}


def _nonlinear(panel: ScenarioPanel) -> bool:
    model = panel.facts.known_model
    return panel.plain and model is not None and not model.linear


SITUATIONS = (
    Situation(
        "free-decay-start-unknown", "One mass, free decay, initial state unknown",
        lambda p: _free(p) and _linear(p, 1) and p.facts.initial_state == "unknown" and not _regime(p),
    ),
    Situation(
        "free-decay-start-known", "One mass, free decay, initial state known",
        lambda p: _free(p) and _linear(p, 1) and p.facts.initial_state == "known" and not _regime(p),
    ),
    Situation(
        "few-samples-a-cycle", "One mass, near or beyond two samples a cycle, or nearly aperiodic",
        lambda p: p.plain and _linear(p, 1) and _regime(p),
    ),
    Situation("known-force", "One mass, known force", lambda p: p.plain and p.facts.forced and _linear(p, 1)),
    Situation(
        "added-mass", "One mass, a second record with known mass added",
        lambda p: p.plain and bool(p.facts.added_mass) and _linear(p, 1),
    ),
    Situation("several-masses", "Several masses, linear", lambda p: p.plain and _linear(p, 2)),
    Situation("nonlinear-free", "Nonlinear, free decay", lambda p: _nonlinear(p) and not p.facts.forced),
    Situation("nonlinear-forced", "Nonlinear, known force", lambda p: _nonlinear(p) and p.facts.forced),
    Situation(
        "disturbed", "One mass, noise that is not white and Gaussian, bias, drift, jitter or outliers",
        lambda p: bool(p.disturbance) and not p.facts.truth_drawn and not _wrong_model(p) and not _regime(p),
    ),
    Situation(
        "wrong-model", "One mass, and the rig has friction, a cubic spring or a mode that the model lacks",
        lambda p: _wrong_model(p),
    ),
)  # fmt: skip
WRONG_MODEL = ("added_friction", "cubic_spring", "second_mode")


def _wrong_model(panel: ScenarioPanel) -> bool:
    return panel.facts.disturbance in WRONG_MODEL


def advise(panels: Sequence[ScenarioPanel]) -> list[Advice]:
    """The situations of which anything is stored."""
    found = []
    for situation in SITUATIONS:
        own = [p for p in panels if situation.has(p) and p.experiments and max_n(p) >= FEWEST_SETS]
        most = max((len(p.methods) for p in own), default=0)
        own = [p for p in own if len(p.methods) >= FEWEST_METHODS * most]
        found += [advice(situation, own)] if own else []
    return found


def max_n(panel: ScenarioPanel) -> int:
    """The data sets of the method that has most."""
    return max((cell.n for cell in panel.methods), default=0)


def advice(situation: Situation, panels: Sequence[ScenarioPanel]) -> Advice:
    """The ranking over some scenarios."""
    results = tuple(result for panel in panels for result in panel.results)
    return Advice(situation.words, f"situations/{situation.name}.md", results, tuple(panels))
