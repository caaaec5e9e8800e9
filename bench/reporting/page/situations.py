"""Situations that a user has before him, and the ranking of methods over all stored scenarios of each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bench.reporting.frame import Result, group
from bench.reporting.page.reading import ScenarioPanel
from bench.reporting.ranking import Ranked, median_time, ranking

HOPELESS = 0.5
"""No method is advised where each of the first tier loses more than this share of its fits."""
FEWEST_METHODS = 0.5
"""Scenarios with less than this share of the situation's methods are studies of a few, and compare no others."""
WRONG_MODEL = ("added_friction", "cubic_spring", "second_mode")
SITUATIONS = {
    "free-decay-start-unknown": "One mass, free decay, initial state unknown",
    "free-decay-start-known": "One mass, free decay, initial state known",
    "few-samples-a-cycle": "One mass, near or beyond two samples a cycle, or nearly aperiodic",
    "known-force": "One mass, known force",
    "added-mass": "One mass, a second record with known mass added",
    "several-masses": "Several masses, linear",
    "nonlinear-free": "Nonlinear, free decay",
    "nonlinear-forced": "Nonlinear, known force",
    "disturbed": "One mass, noise that is not white and Gaussian, bias, drift, jitter or outliers",
    "wrong-model": "One mass, and the rig has friction, a cubic spring or a mode that the model lacks",
}
"""By name, as in addresses, in words."""


@dataclass(frozen=True)
class Advice:
    """The methods of a situation as they are ranked; ``href`` is the page about them.

    ``seconds``: by method, the median processor time of a fit that gave an answer; NaN without any. ``results`` and
    ``panels`` are what is ranked, where it is stored. ``basis`` says on what the ranking rests, and ``error`` what its
    typical errors are over, where that is not the bound; ``needs`` is what all methods of a track have to be given.
    """

    words: str
    href: str
    ranking: Sequence[Ranked]
    seconds: Mapping[str, float]
    results: tuple[Result, ...] = ()
    panels: tuple[ScenarioPanel, ...] = ()
    basis: str = ""
    error: str = ""
    needs: str = ""

    @property
    def first_tier(self) -> list[Ranked]:
        return [row for row in self.ranking if row.tier == 1]

    @property
    def hopeless(self) -> bool:
        """Whether all that could be advised lose most of their fits: then none is."""
        return not any(row.lost <= HOPELESS * row.fits for row in self.first_tier)

    @property
    def fastest(self) -> Ranked:
        """The fastest method of the first tier."""
        return min(self.first_tier, key=lambda row: (np.nan_to_num(self.seconds[row.label], nan=np.inf), row.label))


def advice(words: str, href: str, results: Sequence[Result], panels: Sequence[ScenarioPanel] = ()) -> Advice:
    """Rank the methods of some scenarios."""
    seconds = {label: median_time(its) for label, its in group(results, lambda result: result.label).items()}
    return Advice(words, href, ranking(results), seconds, tuple(results), tuple(panels))


def situation(panel: ScenarioPanel) -> str:
    """Return the name of a scenario's situation; empty where it is of none."""
    facts, model = panel.facts, panel.facts.known_model
    regime = "regimes" in panel.experiments
    if facts.disturbance in WRONG_MODEL:
        return "wrong-model"
    if facts.truth_drawn or model is None or (regime and facts.disturbance):
        return ""
    if facts.disturbance:
        return "disturbed"
    if not model.linear:
        return "nonlinear-forced" if facts.forced else "nonlinear-free"
    if model.n_hidden:
        return ""
    if model.n_dof > 1:
        return "several-masses"
    if regime:
        return "few-samples-a-cycle"
    if facts.added_mass:
        return "added-mass"
    return "known-force" if facts.forced else f"free-decay-start-{facts.initial_state}"


def advise(panels: Sequence[ScenarioPanel]) -> list[Advice]:
    """Rank the methods of each situation of which anything is stored."""
    by_name, ranked = group((panel for panel in panels if panel.experiments), situation), []
    for name, words in SITUATIONS.items():
        most = max((len(panel.methods) for panel in by_name.get(name, [])), default=0)
        its = [panel for panel in by_name.get(name, []) if len(panel.methods) >= FEWEST_METHODS * most]
        results = [result for panel in its for result in panel.results]
        ranked += [advice(words, f"situations/{name}.md", results, its)] if its else []
    return ranked
