"""The numbers of a family's table: what is said of one cell, and how a text says it."""

from __future__ import annotations

import math

import numpy as np

from bench.reporting.family import Place
from bench.reporting.frame import ERROR, Result
from bench.reporting.rounding import excess_text, number, percent
from bench.reporting.tables.pooling import root_mean_square
from bench.scoring.traces import MOMENTS

PLACE: Place = (20.0, "known")
"""The scenario in which trainings are compared."""
MISSING = "not computed"
GROUP = "k_over_m"
"""The group whose errors are followed through a training."""
OTHER = "c_over_m"
NEAR = 1.1
"""So many times the oracle's error is as good as the oracle."""
ACCURACY = {
    "k_over_m_excess": "k/m",
    "c_over_m_excess": "c/m",
    "displacement_excess": "x",
    "k_over_m_coverage_95": "95 %",
}
"""The quantities of every cell, and what stands over them."""
TRAINING = {
    "loss_over_minimum": "loss at end / minimum", "certificate": "certificate", "training_s": "training s",
    "arrival_s": "s to within 1 % of the minimum", "oracle_s": f"s to {NEAR:g} × oracle",
    "k_over_m_excess_at_minimum": "k/m at minimum",
    "c_over_m_excess_at_minimum": "c/m at minimum", "fit_s": "whole fit s", "peak_memory_mb": "memory MB",
}  # fmt: skip
"""The quantities of a training, likewise; ``arrived_share`` stands beside the second of the times."""


def accuracy(one: Result, n: int | None = None) -> dict[str, float]:
    """Root mean square errors over the bound, and the share of the 95 % intervals of k/m that held the truth.

    With ``n``, of the first n replicates alone.
    """
    hits = one.successful(f"{GROUP}_coverage_95", n)
    return {
        "k_over_m_excess": root_mean_square(one.successful(GROUP + ERROR, n)) / one.bound(GROUP + ERROR),
        "c_over_m_excess": root_mean_square(one.successful(OTHER + ERROR, n)) / one.bound(OTHER + ERROR),
        "displacement_excess": root_mean_square(one.successful("rmse", n)) / one.bound("rmse"),
        "k_over_m_coverage_95": float(np.mean(hits)) if hits.size else math.nan,
    }


def training(one: Result, oracle: Result | None, n: int | None = None) -> dict[str, float]:
    """How the training went; NaN for what is not known of this method, infinite for what never came.

    The errors at the minimum are those of the first n replicates.
    """
    share, seconds = arrival(one)
    memory = one.stored.columns.numbers("peak_memory_mb") if one.stored else np.empty(0)
    return {
        "loss_over_minimum": one.statistic("loss_over_minimum", "median"),
        "certificate": one.statistic("certificate", "median"),
        "training_s": one.statistic("training_s", "median"),
        "arrival_s": seconds, "arrived_share": share, "oracle_s": oracle_seconds(one, oracle),
        "k_over_m_excess_at_minimum": at_minimum(one, n)[0],
        "c_over_m_excess_at_minimum": at_minimum(one, n)[1],
        "fit_s": median(one.cpu_s), "peak_memory_mb": median(memory),
    }  # fmt: skip


def at_minimum(one: Result, n: int | None = None) -> tuple[float, float]:
    """Errors of k/m and c/m over the bound, had each training ended at the minimum of its own loss.

    With ``n``, of the first n replicates alone.
    """
    first, second = (
        root_mean_square(one.successful(f"{group}_off_pct_at_minimum", n)) / one.bound(group + ERROR)
        for group in (GROUP, OTHER)
    )
    return first, second


def arrival(one: Result) -> tuple[float, float]:
    """The share of all fits that came within 1 % of their minimum for good, and the median time of those (s)."""
    if not one.successful("loss_over_minimum").size:
        return math.nan, math.nan
    seconds = one.successful("arrival_s")
    return seconds.size / one.n, median(seconds) if seconds.size else math.inf


def oracle_seconds(one: Result, oracle: Result | None) -> float:
    """The first moment (s) from which on the error of k/m stays within 1.1 times the oracle's; infinite if never.

    Both are root mean squares over the same replicates, those in which both succeeded.
    """
    if oracle is None or not one.successful("training_s").size:
        return math.nan
    n = min(one.n, oracle.n)
    both = one.ok[:n] & oracle.ok[:n]
    limit = NEAR * root_mean_square(oracle.scores(GROUP + ERROR)[:n][both])
    first = math.inf
    for moment in reversed(MOMENTS):
        if not root_mean_square(one.scores(moment_score(moment))[:n][both]) <= limit:
            break
        first = moment
    return first


def moment_score(moment: float) -> str:
    """The score that has the error at a moment (s) of a training."""
    return f"{GROUP}_off_pct_at_{moment:g}s"


def median(values: np.ndarray) -> float:
    """The median of what is finite; NaN of nothing."""
    own = values[np.isfinite(values)]
    return float(np.median(own)) if own.size else math.nan


def text(quantity: str, value: float) -> str:
    """A number as the table shows it."""
    if quantity in ("arrival_s", "oracle_s") and math.isinf(value):
        return "never"
    if quantity.startswith("k_over_m_coverage"):
        return percent(value)
    if "excess" in quantity:
        return excess_text(value)
    if quantity == "peak_memory_mb":
        return "-" if math.isnan(value) else f"{value:.0f}"
    if quantity == "loss_over_minimum" and math.isfinite(value) and value < 100:
        return f"{value:.3f}"
    return number(value)
