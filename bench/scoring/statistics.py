"""Intervals and tests of few numbers that scipy does not have, or not for many sets at once."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from scipy.special import ndtri

RESAMPLES = 2000
Z95 = float(ndtri(0.975))
LEVEL = 0.05
"""Level of tests."""
MOST_LAGS = 10
PER_LAG = 5
"""Samples for each lag: the advice of R. J. Hyndman, G. Athanasopoulos, Forecasting, 3rd ed. 2021, section 5.4."""
DRAWS = 999
"""Draws of white noise; 999 make the p-value exact at 5 % (Davison and Hinkley, Bootstrap Methods, 1997, 4.2)."""


@lru_cache(maxsize=16)
def counts(n: int, resamples: int = RESAMPLES) -> np.ndarray:
    """Draw resamples of n replicates, the same ones at every call: how often each is in each, shape (n, resamples)."""
    drawn = np.random.default_rng(0).integers(0, n, (resamples, n))
    places = drawn + n * np.arange(resamples)[:, None]
    return np.bincount(places.ravel(), minlength=drawn.size).reshape(resamples, n).T.astype(np.int16, order="C")


def medians(values: np.ndarray, often: np.ndarray) -> np.ndarray:
    """Compute the median of each resample, shape (resamples,).

    Args:
        values: What was resampled (n,), some perhaps infinite: a mean of a number and infinity is infinite, never NaN.
        often: How often each of them is in each resample, (n, resamples).
    """
    order, middle = np.argsort(values, kind="stable"), (values.size - 1) // 2
    ordered, total = values[order], np.cumsum(often[order], axis=0, dtype=often.dtype)
    below = np.sum(total <= middle, axis=0, dtype=np.int16)
    if values.size % 2:
        return np.asarray(ordered[below])
    return np.asarray(0.5 * (ordered[below] + ordered[np.sum(total <= middle + 1, axis=0, dtype=np.int16)]))


def middle_95(resampled: np.ndarray) -> tuple[float, float]:
    """Return the 2.5 % and 97.5 % quantiles of resampled statistics, as values among them."""
    ends = np.sort(resampled)[[math.ceil(level * resampled.size) - 1 for level in (0.025, 0.975)]]
    return float(ends[0]), float(ends[1])


def wilson_interval(k: int, n: int) -> tuple[float, float]:
    """Return the 95 % interval of a fraction, ``k`` of ``n`` seen (E. B. Wilson, J. Am. Stat. Assoc. 22:209, 1927)."""
    z2 = Z95**2
    half = Z95 * math.sqrt(k * (n - k) / n + z2 / 4)
    return max(0.0, float((k + z2 / 2 - half) / (n + z2))), min(1.0, float((k + z2 / 2 + half) / (n + z2)))


def ljung_box(residuals: np.ndarray) -> np.ndarray:
    """Return ``Q = n (n + 2) Σ r_k² / (n - k)`` of residuals (sets, n), shape (sets,).

    G. M. Ljung, G. E. P. Box, Biometrika 65:297, 1978; r_k is the autocorrelation at lag k, up to :data:`MOST_LAGS` or
    a lag for each :data:`PER_LAG` samples. NaN where a set is constant or not finite.
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
    """Return the p-values (sets,) of the Ljung-Box statistic of residuals (sets, n); NaN where a set has none.

    A fit takes the directions of its ``tangents`` (n, q) out of the noise, which leaves residuals correlated although
    the noise is white: with few samples chi-square rejects three times as often as it should. So the statistic is
    compared with that of white noise from which the same directions were taken.
    """
    n = residuals.shape[1]
    noise = np.random.default_rng(n).standard_normal((DRAWS, n))
    basis = np.linalg.qr(tangents)[0]
    null = np.sort(ljung_box(noise - (noise @ basis) @ basis.T))
    q = ljung_box(residuals)
    above = DRAWS - np.searchsorted(null, np.where(np.isfinite(q), q, 0.0), side="left")
    return np.where(np.isfinite(q), (1.0 + above) / (DRAWS + 1.0), np.nan)


def bias_share(ratios: np.ndarray) -> float:
    """The share of the mean square error of ``ratios`` (estimate over truth, shape (n,)) that is bias squared.

    The mean square of an error is its mean squared plus its variance. The square of the mean of n errors is too large
    by their variance over n on average, which is taken off, down to nothing; NaN below three replicates and where there
    is no error.
    """
    if ratios.size < 3:
        return math.nan
    errors = ratios - 1.0
    with np.errstate(over="ignore", invalid="ignore"):
        total = float(np.mean(errors**2))
        bias = float(np.mean(errors) ** 2 - np.var(errors, ddof=1) / errors.size)
    return max(bias, 0.0) / total if 0 < total < math.inf else math.nan
