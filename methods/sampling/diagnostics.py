"""Convergence diagnostics of chains: R-hat and autocorrelation time."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

WINDOW = 5.0


def autocorrelation_times(paths: np.ndarray) -> np.ndarray:
    """Estimate integrated autocorrelation times in steps, (ensembles, size), of chains (ensembles, steps, walkers,
    size).

    As in emcee, the autocorrelation is averaged over walkers and summed up to ``WINDOW`` times the sum (A. Sokal, Monte
    Carlo Methods in Statistical Mechanics, 1989). NaN where a walker never moves.
    """
    steps = paths.shape[1]
    series = np.ascontiguousarray(np.moveaxis(paths, 1, -1))
    transformed = np.fft.rfft(series - series.mean(axis=-1, keepdims=True), n=2 * steps)
    power = transformed.real**2 + transformed.imag**2
    with np.errstate(invalid="ignore"):
        covariances = np.fft.irfft(power, n=2 * steps)[..., :steps]
        correlations = np.mean(covariances / covariances[..., :1], axis=1)
    sums = 2.0 * np.cumsum(correlations, axis=-1) - 1.0
    within = np.arange(steps) < WINDOW * sums
    last = np.where(np.any(within, axis=-1), np.argmin(within, axis=-1), steps - 1)
    return np.asarray(np.take_along_axis(sums, last[..., None], axis=-1)[..., 0])


def rank_r_hat(paths: np.ndarray) -> float:
    """Return the largest rank-normalised split R-hat over the unknowns of chains (ensembles, steps, walkers, size).

    The sequences compared are the first and second half of each ensemble with all its walkers, which are not
    independent. It is the larger of the bulk and the folded version (Vehtari et al., 2021, equations 1-4, 14 and
    section 4.2). Infinite where an unknown never moves.
    """
    from scipy.stats import rankdata  # slow to import

    steps = paths.shape[1] // 2
    x = np.stack([half.reshape(-1, paths.shape[-1]) for path in paths for half in (path[:steps], path[-steps:])])

    def classic(draws: np.ndarray) -> np.ndarray:
        ranks = rankdata(draws.reshape(-1, draws.shape[-1]), axis=0).reshape(draws.shape)
        z = ndtri((ranks - 0.375) / (draws[..., 0].size + 0.25))
        within = np.mean(np.var(z, axis=1, ddof=1), axis=0)
        n = draws.shape[1]
        total = (n - 1) / n * within + np.var(z.mean(axis=1), axis=0, ddof=1)
        return np.asarray(np.sqrt(total / within))

    with np.errstate(all="ignore"):
        both = np.concatenate([classic(x), classic(np.abs(x - np.median(x, axis=(0, 1))))])
    moved = np.ptp(x, axis=(0, 1)) > 0
    return float(np.max(both)) if np.all(moved) and np.all(np.isfinite(both)) else float("inf")
