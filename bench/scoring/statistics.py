"""Intervals and tests that scipy lacks, or does not vectorise over many data sets."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from scipy.special import ndtri

RESAMPLES = 2000
Z95 = float(ndtri(0.975))
LEVEL = 0.05
"""Significance level of all tests."""
MOST_LAGS = 10
PER_LAG = 5
"""Samples per lag of the Ljung-Box test (R. J. Hyndman, G. Athanasopoulos, Forecasting, 3rd ed. 2021, section 5.4)."""
DRAWS = 999
"""Simulations of white noise; with 999 the p-value is exact at 5 % (Davison and Hinkley, Bootstrap Methods, 1997,
section 4.2)."""


@lru_cache(maxsize=16)
def counts(n: int, resamples: int = RESAMPLES) -> np.ndarray:
    """Draw bootstrap resamples of n replicates; return how often each occurs in each resample, (n, resamples).

    The random seed is fixed, so that summaries are reproducible.
    """
    drawn = np.random.default_rng(0).integers(0, n, (resamples, n))
    flat_indices = drawn + n * np.arange(resamples)[:, None]
    return np.bincount(flat_indices.ravel(), minlength=drawn.size).reshape(resamples, n).T.astype(np.int16, order="C")


def medians(values: np.ndarray, occurrences: np.ndarray) -> np.ndarray:
    """Compute the median of each resample, (resamples,).

    Args:
        values: Resampled values (n,), which may be infinite.
        occurrences: Number of times that each value occurs in each resample, (n, resamples).
    """
    order, middle = np.argsort(values, kind="stable"), (values.size - 1) // 2
    ordered, total = values[order], np.cumsum(occurrences[order], axis=0, dtype=occurrences.dtype)
    below = np.sum(total <= middle, axis=0, dtype=np.int16)
    if values.size % 2:
        return np.asarray(ordered[below])
    return np.asarray(0.5 * (ordered[below] + ordered[np.sum(total <= middle + 1, axis=0, dtype=np.int16)]))


def middle_95(resampled: np.ndarray) -> tuple[float, float]:
    """Return the 2.5 % and 97.5 % quantiles of resampled statistics, without interpolation."""
    ends = np.sort(resampled)[[math.ceil(level * resampled.size) - 1 for level in (0.025, 0.975)]]
    return float(ends[0]), float(ends[1])


def wilson_interval(k: int, n: int) -> tuple[float, float]:
    """Return the 95 % interval of a fraction from ``k`` successes in ``n`` trials.

    E. B. Wilson, J. Am. Stat. Assoc. 22:209, 1927.
    """
    z2 = Z95**2
    half = Z95 * math.sqrt(k * (n - k) / n + z2 / 4)
    return max(0.0, float((k + z2 / 2 - half) / (n + z2))), min(1.0, float((k + z2 / 2 + half) / (n + z2)))


def ljung_box(residuals: np.ndarray) -> np.ndarray:
    """Compute the statistic ``Q = n (n + 2) Σ r_k² / (n - k)``, (sets,), of residuals (sets, n).

    G. M. Ljung, G. E. P. Box, Biometrika 65:297, 1978. r_k is the autocorrelation at lag k; the number of lags is
    ``n / PER_LAG``, at most :data:`MOST_LAGS`. NaN for a set that is constant or not finite.
    """
    n = residuals.shape[1]
    lags = np.arange(1, max(1, min(MOST_LAGS, n // PER_LAG)) + 1)
    centred = residuals - np.mean(residuals, axis=1, keepdims=True)
    with np.errstate(all="ignore"):
        moments = np.stack([np.sum(centred[:, k:] * centred[:, : n - k], axis=1) for k in lags], axis=1)
        correlations = moments / np.sum(centred**2, axis=1)[:, None]
        q = n * (n + 2) * np.sum(correlations**2 / (n - lags), axis=1)
    return np.where(np.isfinite(q), q, np.nan)


def whiteness(residuals: np.ndarray, tangents: np.ndarray) -> np.ndarray:
    """Return p-values (sets,) of the Ljung-Box test of the residuals of a fit.

    A fit removes the span of its Jacobian from the noise, which leaves the residuals correlated even if the noise is
    white: with few samples the chi-squared approximation rejects three times too often. The statistic is therefore
    compared with that of simulated white noise from which the same span was removed.

    Args:
        residuals: Residuals, (sets, n).
        tangents: Jacobian of the response with respect to the fitted parameters, (n, q).
    """
    n = residuals.shape[1]
    noise = np.random.default_rng(n).standard_normal((DRAWS, n))
    basis = np.linalg.qr(tangents)[0]
    null = np.sort(ljung_box(noise - (noise @ basis) @ basis.T))
    q = ljung_box(residuals)
    above = DRAWS - np.searchsorted(null, np.where(np.isfinite(q), q, 0.0), side="left")
    return np.where(np.isfinite(q), (1.0 + above) / (DRAWS + 1.0), np.nan)


def bias_share(ratios: np.ndarray) -> float:
    """Return the share of the mean square error of ``ratios`` (estimate over true value, (n,)) due to bias.

    The mean square error is the squared mean plus the variance. The squared mean of n errors overestimates the squared
    bias by their variance over n, which is subtracted; a negative result counts as 0. NaN for fewer than three
    replicates, and without any error.
    """
    if ratios.size < 3:
        return math.nan
    errors = ratios - 1.0
    with np.errstate(over="ignore", invalid="ignore"):
        total = float(np.mean(errors**2))
        bias = float(np.mean(errors) ** 2 - np.var(errors, ddof=1) / errors.size)
    return max(bias, 0.0) / total if 0 < total < math.inf else math.nan
