"""From the replicates of a cell to one line a metric: mean, median with its interval, bound and excess."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import gammaincinv, ndtri, stdtrit

from bench.contract.estimate import Status
from bench.information.fisher import Bound
from bench.scoring.resampling import RESAMPLES, counts, medians
from bench.scoring.row import STATISTICS, Row, Rows

Z95 = float(ndtri(0.975))
ALWAYS = ("rmse", "rmse_simulated", "rmse_forecast")
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
    """Decide whether the errors of a quantity are smaller than the bound allows by chance.

    Args:
        excess: Root mean square of the errors over the bound.
        bound_pct: The bound (%), which includes what the prior says.
        n: Number of errors. Squares of normal errors at the bound add up to a chi-square variable of n.

    Returns:
        Whether fewer than one of a million such sets of errors were as small: the method then knows more than the data
        and the prior tell, as the truth.
    """
    least = math.sqrt(2.0 * gammaincinv(n / 2.0, CHANCE) / n) if n > 0 else 0.0
    return excess < least and bound_pct <= LARGEST_BOUND_PCT


def summarise(rows: Sequence[Row], bound: Bound) -> dict[str, Line]:
    """Summarise every metric that any replicate has, and those that every cell has (NaN where none succeeded)."""
    bounds, columns = metric_bounds(bound), Rows.of(rows)
    good = np.array([status is Status.OK for status in columns.statuses], bool)
    scores = {name: columns.scores(name)[good] for name in columns.score_names if not name.endswith("_ratio")}
    metrics = [name for name, values in scores.items() if not np.all(np.isnan(values))]
    result = {}
    for name in dict.fromkeys([*metrics, *(() if np.any(good) else bounds), *ALWAYS]):
        values = scores.get(name, np.full(np.sum(good), np.nan))
        known = values[~np.isnan(values)]
        if name.endswith("_pit") or name.startswith("band_inside"):
            result[name] = _share(known)
        elif "_coverage_" in name:
            result[name] = _coverage(known)
        else:
            errors = np.full(len(rows), np.inf)
            errors[good] = np.where(np.isnan(values), np.inf, values)
            result[name] = _error(errors, bounds.get(name, float("nan")))
    return result


def _error(values: np.ndarray, bound: float) -> Line:
    good = values[np.isfinite(values)]
    resampled = np.sort(medians(values, counts(values.size)))
    low, high = resampled[[math.ceil(level * RESAMPLES) - 1 for level in (0.025, 0.975)]]
    excess = float(np.sqrt(np.mean(good**2)) / bound) if good.size and np.isfinite(bound) and bound > 0 else np.nan
    mean = float(np.mean(values)) if good.size == values.size else float("inf")
    return _line(mean, float(np.median(values)), float(low), float(high), bound, excess, int(good.size))


def _line(*values: float) -> Line:
    return dict(zip(STATISTICS, values, strict=True))


def _share(values: np.ndarray) -> Line:
    """Summarise numbers between 0 and 1 that are no errors, with the interval of their mean (Student's t)."""
    nan = float("nan")
    if values.size < 2:
        only = float(values[0]) if values.size else nan
        return _line(only, only, nan, nan, nan, nan, int(values.size))
    half = float(stdtrit(values.size - 1, 0.975) * values.std(ddof=1) / np.sqrt(values.size))
    mean = float(values.mean())
    return _line(mean, float(np.median(values)), mean - half, mean + half, nan, nan, int(values.size))


def _coverage(hits: np.ndarray) -> Line:
    nan = float("nan")
    if not hits.size:
        return _line(nan, nan, nan, nan, nan, nan, 0)
    low, high = wilson_interval(int(hits.sum()), hits.size)
    return _line(float(hits.mean()), float(np.median(hits)), low, high, nan, nan, int(hits.size))


def wilson_interval(k: int, n: int) -> tuple[float, float]:
    """Return the 95 % interval of a fraction, ``k`` of ``n`` seen (E. B. Wilson, J. Am. Stat. Assoc. 22:209, 1927)."""
    z2 = Z95**2
    half = Z95 * math.sqrt(k * (n - k) / n + z2 / 4)
    return max(0.0, float((k + z2 / 2 - half) / (n + z2))), min(1.0, float((k + z2 / 2 + half) / (n + z2)))
