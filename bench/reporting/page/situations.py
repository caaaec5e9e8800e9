"""Situations of users, and the ranking of methods over the stored scenarios of each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bench.reporting.frame import Result, group
from bench.reporting.page.reading import ScenarioPanel
from bench.reporting.ranking import Ranked, median_time, ranking

HOPELESS = 0.5
"""No method is recommended if each of the first tier has a larger share of outlier fits."""
FEWEST_METHODS = 0.5
"""Smallest share of a situation's methods in a scenario; those with fewer are left out of the ranking."""
WRONG_MODEL = ("added_friction", "cubic_spring", "second_mode")
SITUATIONS = {
    "free-decay-start-unknown": "One mass, free decay, initial state unknown",
    "free-decay-start-known": "One mass, free decay, initial state known",
    "few-samples-a-cycle": "One mass, about two samples per cycle or fewer, or nearly aperiodic",
    "known-force": "One mass, known force",
    "added-mass": "One mass, a second record with known mass added",
    "several-masses": "Several masses, linear",
    "nonlinear-free": "Nonlinear, free decay",
    "nonlinear-forced": "Nonlinear, known force",
    "disturbed": "One mass, noise that is not white and Gaussian, bias, drift, jitter or outliers",
    "wrong-model": "One mass, but with friction, a cubic spring or a mode that the model lacks",
}
"""Titles of the situations, by the name in their address."""


@dataclass(frozen=True)
class Advice:
    """The ranking of the methods in a situation.

    Attributes:
        title: Title of the situation.
        href: Page of the ranking.
        ranking: Ranks of the methods.
        seconds: Median processor time of a successful fit by method; NaN without any.
        results: Ranked results, if they are cells.
        panels: Their scenarios.
        basis: Data of the ranking, if they are not scenarios.
        error: Meaning of the errors, if they are not relative to the Cramér-Rao bound.
        needs: Requirements of all methods, if they are not on their cards.
    """

    title: str
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
        """Whether all methods of the first tier fail in most fits, so that none is recommended."""
        return not any(row.lost <= HOPELESS * row.fits for row in self.first_tier)

    @property
    def fastest(self) -> Ranked:
        """The fastest method of the first tier."""
        return min(self.first_tier, key=lambda row: (np.nan_to_num(self.seconds[row.label], nan=np.inf), row.label))


def advice(title: str, href: str, results: Sequence[Result], panels: Sequence[ScenarioPanel] = ()) -> Advice:
    """Rank the methods of some scenarios."""
    seconds = {label: median_time(members) for label, members in group(results, lambda result: result.label).items()}
    return Advice(title, href, ranking(results), seconds, tuple(results), tuple(panels))


def situation(panel: ScenarioPanel) -> str:
    """Return the name of a scenario's situation; empty if it belongs to none."""
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
    """Rank the methods of each situation with stored scenarios."""
    by_name, ranked = group((panel for panel in panels if panel.experiments), situation), []
    for name, title in SITUATIONS.items():
        most = max((len(panel.methods) for panel in by_name.get(name, [])), default=0)
        members = [panel for panel in by_name.get(name, []) if len(panel.methods) >= FEWEST_METHODS * most]
        results = [result for panel in members for result in panel.results]
        ranked += [advice(title, f"situations/{name}.md", results, members)] if members else []
    return ranked
