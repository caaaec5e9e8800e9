"""Tests of whether the residuals of a fit are white noise: those of a wrong model are not."""

from __future__ import annotations

import numpy as np

MOST_LAGS = 10
PER_LAG = 5
"""Samples for each lag: the advice of R. J. Hyndman, G. Athanasopoulos, Forecasting, 3rd ed. 2021, section 5.4."""
DRAWS = 999
"""Of white noise; with 999 the p-value is exact at 5 % (A. C. Davison, D. V. Hinkley, Bootstrap Methods, 1997, 4.2)."""


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
