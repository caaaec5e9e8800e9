"""From the replicates of a cell to one line a metric: mean, median with its interval, bound and excess."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import gammaincinv, stdtrit

from bench.contract.estimate import Status
from bench.information.fisher import Bound
from bench.scoring.row import STATISTICS, Row, Rows
from bench.scoring.statistics import counts, medians, middle_95, wilson_interval

ALWAYS = ("rmse", "rmse_simulated", "rmse_forecast")
GROSS = 5.0
"""An error beyond this many times the bound is that of an outlier fit."""
CHANCE = 1e-6
"""Probability at which a root mean square error is too small to be chance: no published cell is, of 22,000."""
LARGEST_BOUND_PCT = 50.0
"""A bound that is larger is no limit: it is of a linearisation, and errors of positive numbers are bounded below."""

Line = dict[str, float]
"""The statistics of a metric by name."""


def metric_bounds(bound: Bound) -> dict[str, float]:
    """Return the bound on the root mean square of each metric that has one."""
    errors = {f"{name}_error_pct": 100.0 * sd for name, sd in bound.relative_sd.items()}
    return errors | {"rmse": bound.rmse, "rmse_simulated": bound.rmse, "rmse_forecast": bound.rmse_forecast}


def below_chance(excess: float, bound_pct: float, n: int) -> bool:
    """Decide whether errors are smaller than the bound allows by chance, so that the method must know the truth.

    ``excess``: root mean square of n errors over the bound ``bound_pct`` (%), which includes the prior. Squares of
    normal errors at the bound add up to a chi-square variable of n.
    """
    least = math.sqrt(2.0 * gammaincinv(n / 2.0, CHANCE) / n) if n > 0 else 0.0
    return excess < least and bound_pct <= LARGEST_BOUND_PCT


def gross(errors: np.ndarray, bound: float) -> np.ndarray:
    """Return which errors (n,) are of outlier fits or of failures, which are infinite; without a bound only these."""
    limit = GROSS * bound if np.isfinite(bound) and bound > 0 else np.inf
    return np.asarray(~(errors <= limit) | np.isinf(errors))


def summarise(rows: Sequence[Row], bound: Bound) -> dict[str, Line]:
    """Summarise every metric that any replicate has, and those that every cell has (NaN where none succeeded)."""
    bounds, columns = metric_bounds(bound), Rows.of(rows)
    good = np.array([status is Status.OK for status in columns.statuses], bool)
    scores = {name: columns.scores(name)[good] for name in columns.score_names if not name.endswith("_ratio")}
    metrics = [name for name, values in scores.items() if not np.all(np.isnan(values))]
    result = {}
    for name in dict.fromkeys([*metrics, *(() if np.any(good) else bounds), *ALWAYS]):
        values = scores.get(name, np.full(np.sum(good), np.nan))
        if name.endswith("_pit") or name.startswith("band_inside") or "_coverage_" in name:
            result[name] = _share(values[~np.isnan(values)], hits="_coverage_" in name)
        else:
            errors = np.full(len(rows), np.inf)
            errors[good] = np.where(np.isnan(values), np.inf, values)
            result[name] = _error(errors, bounds.get(name, math.nan))
    return result


def _line(*values: float, n_ok: int) -> Line:
    return dict(zip(STATISTICS, [*map(float, values), n_ok], strict=True))


def _error(values: np.ndarray, bound: float) -> Line:
    """Summarise errors, those of failures infinite, with the bootstrap's interval of their median."""
    good = values[np.isfinite(values)]
    ends = middle_95(medians(values, counts(values.size)))
    excess = np.sqrt(np.mean(good**2)) / bound if good.size and np.isfinite(bound) and bound > 0 else np.nan
    mean = np.mean(values) if good.size == values.size else np.inf
    return _line(mean, np.median(values), *ends, bound, excess, n_ok=good.size)


def _share(values: np.ndarray, hits: bool) -> Line:
    """Summarise numbers between 0 and 1: the interval of their mean is Wilson's of hits, else Student's t."""
    n, ends = values.size, (np.nan, np.nan)
    if not n:
        return _line(*[np.nan] * 6, n_ok=0)
    mean = values.mean()
    if hits:
        ends = wilson_interval(int(values.sum()), n)
    elif n > 1:
        half = stdtrit(n - 1, 0.975) * values.std(ddof=1) / np.sqrt(n)
        ends = mean - half, mean + half
    return _line(mean, np.median(values), *ends, np.nan, np.nan, n_ok=n)
