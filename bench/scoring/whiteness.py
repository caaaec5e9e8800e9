"""Whether residuals are white noise: what a wrong model leaves is not."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtrc

MOST_LAGS = 10
PER_LAG = 5
"""Samples for each lag: the advice of R. J. Hyndman, G. Athanasopoulos, Forecasting, 3rd ed. 2021, section 5.4."""


def ljung_box(residuals: np.ndarray) -> np.ndarray:
    """The p-values (sets,) of residuals (sets, n) that white noise has autocorrelations as large.

    ``Q = n (n + 2) Σ r_k² / (n - k)`` is compared with chi-square of as many degrees of freedom as there are lags k
    (G. M. Ljung, G. E. P. Box, Biometrika 65:297, 1978): :data:`MOST_LAGS`, or a lag for each :data:`PER_LAG` samples.
    NaN where a set is constant or not finite.
    """
    n = residuals.shape[1]
    lags = np.arange(1, max(1, min(MOST_LAGS, n // PER_LAG)) + 1)
    centred = residuals - np.mean(residuals, axis=1, keepdims=True)
    with np.errstate(all="ignore"):
        moments = np.stack([np.sum(centred[:, k:] * centred[:, : n - k], axis=1) for k in lags], axis=1)
        correlations = moments / np.sum(centred**2, axis=1)[:, None]
        q = n * (n + 2) * np.sum(correlations**2 / (n - lags), axis=1)
    return np.where(np.isfinite(q), chdtrc(lags.size, np.where(np.isfinite(q), q, 0.0)), np.nan)
