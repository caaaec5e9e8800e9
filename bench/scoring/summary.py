"""Summaries of a cell's replicates: per metric the mean, the median with its interval, the bound and the excess."""

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
OUTLIER_FACTOR = 5.0
"""An outlier fit has an error beyond this many times the bound."""
CHANCE = 1e-6
"""Probability below which a small root mean square error is not attributed to chance; no published cell is below it."""
LARGEST_BOUND_PCT = 50.0
"""A larger bound (%) is not a limit: the linearisation fails, and errors of positive quantities are at most 100 % on
one side."""

Line = dict[str, float]
"""Statistics of a metric by name."""


def metric_bounds(bound: Bound) -> dict[str, float]:
    """Return the lower bound on the root mean square error of each metric that has one."""
    errors = {f"{name}_error_pct": 100.0 * sd for name, sd in bound.relative_sd.items()}
    return errors | {"rmse": bound.rmse, "rmse_simulated": bound.rmse, "rmse_forecast": bound.rmse_forecast}


def below_chance(excess: float, bound_pct: float, n: int) -> bool:
    """Return whether errors are smaller than the bound allows by chance, so that the method must know the true values.

    The sum of squares of n normal errors at the bound is chi-squared distributed with n degrees of freedom.

    Args:
        excess: Root mean square of the errors over the bound, which includes the prior.
        bound_pct: The bound, %.
        n: Number of errors.
    """
    least = math.sqrt(2.0 * gammaincinv(n / 2.0, CHANCE) / n) if n > 0 else 0.0
    return excess < least and bound_pct <= LARGEST_BOUND_PCT


def outlier_fits(errors: np.ndarray, bound: float) -> np.ndarray:
    """Return a mask (n,) of errors that are infinite (failures) or beyond :data:`OUTLIER_FACTOR` times the bound."""
    limit = OUTLIER_FACTOR * bound if np.isfinite(bound) and bound > 0 else np.inf
    return np.asarray(~(errors <= limit) | np.isinf(errors))


def summarise(rows: Sequence[Row], bound: Bound) -> dict[str, Line]:
    """Summarise every metric of the replicates, and the metrics that every cell has (NaN if no replicate succeeded)."""
    bounds, columns = metric_bounds(bound), Rows.from_rows(rows)
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
    """Summarise errors (failures are infinite); the interval is a bootstrap interval of the median."""
    good = values[np.isfinite(values)]
    ends = middle_95(medians(values, counts(values.size)))
    excess = np.sqrt(np.mean(good**2)) / bound if good.size and np.isfinite(bound) and bound > 0 else np.nan
    mean = np.mean(values) if good.size == values.size else np.inf
    return _line(mean, np.median(values), *ends, bound, excess, n_ok=good.size)


def _share(values: np.ndarray, hits: bool) -> Line:
    """Summarise numbers in [0, 1]; the interval of the mean is Wilson's for ``hits`` (0 or 1), else Student's t."""
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
