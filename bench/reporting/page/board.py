"""The leaderboard's lines as numbers: one a scenario, method and quantity, loaded a system at a time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bench.contract.estimate import Status
from bench.reporting.frame import ERROR, Result
from bench.reporting.page.reading import ScenarioPanel
from bench.reporting.ranking import first_tier, median_time
from bench.scoring.summary import gross

SHARED = ("scenario", "quantity", "bound", "prior")
"""What all lines of a block have in common."""
COLUMNS = ("method", "standing", "rms", "excess", "median", "low", "high", "gross", "ok", "n", "seconds")
"""Of each line; names are places in the lists of methods, quantities and standings."""
STANDINGS = ("first tier", "behind", "not ranked", "reference", "failed", "unsupported")
"""In the order in which a board is sorted at first."""
Rankings = dict[tuple[int, str], frozenset[Result]]
"""The first tier by the scenario's place and by metric."""
Line = list[float | int | None]


def rankings(panels: Sequence[ScenarioPanel]) -> Rankings:
    """Every scenario's first tier by every metric that its data decide."""
    return {
        (i, metric): first_tier(panel.results, [metric]) for i, panel in enumerate(panels) for metric in panel.ranked
    }


def blocks(
    place: int, panel: ScenarioPanel, ranked: Rankings, methods: Mapping[str, int], quantities: Mapping[str, int]
) -> list[list[Any]]:
    """One a quantity of a scenario: what its lines share (:data:`SHARED`), then the lines (:data:`COLUMNS`)."""
    found = []
    for metric in panel.metrics:
        own = [result for result in panel.results if metric in result.summary]
        bound = next((result.bound(metric) for result in own), math.nan)
        share = math.nan if metric == "rmse" else panel.prior_share.get(metric.removesuffix(ERROR), math.nan)
        lines = [line(result, metric, methods, ranked.get((place, metric))) for result in own]
        found.append([place, quantities[metric], short(bound), short(share), lines])
    return found


def line(result: Result, metric: str, methods: Mapping[str, int], tier: frozenset[Result] | None) -> Line:
    """A method's numbers; None for what is not there."""
    errors = result.errors(metric)
    unable = result.status is Status.UNSUPPORTED
    off = math.nan if unable or not errors.size else float(np.mean(gross(errors, result.bound(metric))))
    median, low, high, excess = (result.statistic(metric, name) for name in ("median", "ci_low", "ci_high", "excess"))
    measured = [root_mean_square(errors), excess, median, low, high, off]
    head = [methods[result.label], STANDINGS.index(standing_of(result, tier))]
    return [*head, *map(short, measured), result.n_ok, result.n, short(median_time([result]))]


def root_mean_square(errors: np.ndarray) -> float:
    """Of the errors of the successful fits, as in × bound; NaN where none succeeded."""
    good = errors[np.isfinite(errors)]
    with np.errstate(over="ignore"):  # an infinite one says as much
        return float(np.sqrt(np.mean(good**2))) if good.size else math.nan


def middle(values: Sequence[float]) -> float:
    """The median of the finite values; NaN where there is none."""
    finite = [value for value in values if math.isfinite(value)]
    return float(np.median(finite)) if finite else math.nan


def short(value: float) -> float | None:
    """Four significant digits; None for what is not finite."""
    return float(f"{value:.4g}") if math.isfinite(value) else None


def standing_of(result: Result, tier: frozenset[Result] | None) -> str:
    """One of :data:`STANDINGS`."""
    if result.is_reference:
        return "reference"
    if result.status is Status.UNSUPPORTED:
        return "unsupported"
    if result.n_ok == 0:
        return "failed"
    if not tier:
        return "not ranked"
    return "first tier" if result in tier else "behind"
