"""Which methods are tied with the best in a scenario."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from bench.reporting.frame import Result
from bench.reporting.page.reading import ScenarioPanel
from bench.scoring.comparison import standing

Place = Literal["tied with the best", "behind", "only method", "all failed"]


@dataclass(frozen=True)
class Ranking:
    """Of one scenario and metric: every method's place.

    ``weak``: tied with the best on fewer replicates than the best has, so that less could have been told.
    """

    places: Mapping[str, Place]
    weak: frozenset[str] = frozenset()


def rank(panel: ScenarioPanel, metric: str) -> Ranking | None:
    """The methods of a scenario by one metric, by the rule of the tables; None where none has it."""
    own = {result.label: result for result in panel.methods if metric in result.summary and result.n}
    if not own:
        return None
    errors = {label: result.errors(metric) for label, result in own.items()}
    failed = {label for label, values in errors.items() if not np.isfinite(values).any()}
    if failed == set(own):
        return Ranking(dict.fromkeys(own, "all failed"))
    bound = next(iter(own.values())).bound(metric)
    found = standing(errors, {label: result.excess(metric) for label, result in own.items()}, bound)
    if found is None:
        return Ranking(dict.fromkeys(own, "only method"))
    places: dict[str, Place] = {
        label: "all failed" if label in failed else "tied with the best" if label in found.level else "behind"
        for label in own
    }  # fmt: skip
    fewer = {label for label in own if places[label] == "tied with the best" and own[label].n < own[found.best].n}
    return Ranking(places, frozenset(fewer))


def fit_seconds(result: Result) -> float:
    """Median processor time of a fit that succeeded (s); NaN where none did."""
    times = result.cpu_s[result.ok & np.isfinite(result.cpu_s)]
    return float(np.median(times)) if times.size else np.nan
