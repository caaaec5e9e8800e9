"""Who is best in a scenario, who is level with the best, and how sure that is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from bench.reporting.frame import Result
from bench.reporting.page.reading import ScenarioPanel
from bench.scoring.comparison import Comparison, standing

Place = Literal["best", "level", "behind", "alone", "all failed"]


@dataclass(frozen=True)
class Ranking:
    """Of one scenario and metric: every method's place, and its comparison with the best.

    ``weak``: level with the best on fewer replicates than the best has, so that less could have been told. ``p_gross``:
    how surely each makes gross errors (:func:`bench.scoring.comparison.steady`).
    """

    places: Mapping[str, Place]
    comparisons: Mapping[str, Comparison]
    weak: frozenset[str]
    p_gross: Mapping[str, float] = field(default_factory=dict)

    @property
    def level(self) -> list[str]:
        """The best and all that are level with it."""
        return [label for label, place in self.places.items() if place in ("best", "level", "alone")]


def rank(panel: ScenarioPanel, metric: str) -> Ranking | None:
    """The methods of a scenario by one metric, by the rule of the tables; None where none has it."""
    own = {result.label: result for result in panel.methods if metric in result.summary and result.n}
    if not own:
        return None
    errors = {label: result.errors(metric) for label, result in own.items()}
    failed = {label for label, values in errors.items() if not np.isfinite(values).any()}
    if failed == set(own):
        return Ranking(dict.fromkeys(own, "all failed"), {}, frozenset())
    bound = next(iter(own.values())).bound(metric)
    found = standing(errors, {label: result.excess(metric) for label, result in own.items()}, bound)
    if found is None:
        return Ranking(dict.fromkeys(own, "alone"), {}, frozenset())
    places: dict[str, Place] = {
        label: "best" if label == found.best else "all failed" if label in failed
        else "level" if label in found.level else "behind"
        for label in own
    }  # fmt: skip
    fewer = {label for label in own if places[label] == "level" and own[label].n < own[found.best].n}
    return Ranking(places, {c.a: c for c in found.comparisons}, frozenset(fewer), found.p_gross)


def fit_seconds(result: Result) -> float:
    """Median processor time of a fit that succeeded (s); NaN where none did."""
    times = result.cpu_s[result.ok & np.isfinite(result.cpu_s)]
    return float(np.median(times)) if times.size else np.nan
