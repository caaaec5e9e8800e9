"""The colour of residuals: their spectrum, and a criterion for models that leave them.

The residuals of a real record are seldom white: the model class is not quite right, the sensor drifts, the floor moves.
"""

from __future__ import annotations

import numpy as np

from bench.likelihood.autoregression import autoregression, log_likelihoods

NEIGHBOURS = 3
"""Fourier frequencies to either side over which a periodogram is smoothed."""
LEAST_SHARE = 0.2
"""Least part of the noise's power that counts as left by a fit near a frequency."""


def local_spectrum(residuals: np.ndarray, slopes: np.ndarray, length: int) -> np.ndarray:
    """Compute the spectrum (length // 2 + 1,) of noise by the periodogram of the residuals (n,) that a fit has left.

    A fit takes away the noise's share along its derivatives (n, p), which lie at the natural frequency, where the
    noise matters most: the mean over neighbours of the periodogram is over the mean of the share that it leaves of each
    frequency, and so has no bias where the spectrum is flat (M. B. Priestley, Spectral Analysis and Time Series, 1981,
    section 6.2, for the smoothing).
    """
    n = residuals.size
    basis = np.linalg.qr(slopes / np.maximum(np.linalg.norm(slopes, axis=0), 1e-300))[0]
    power = np.abs(np.fft.rfft(residuals, length)) ** 2 / n
    share = np.maximum(1.0 - np.sum(np.abs(np.fft.rfft(basis, length, axis=0)) ** 2, axis=1) / n, 0.0)
    reach = max(round(NEIGHBOURS * length / n), 1)
    both = np.stack([power, share])
    mirrored = np.concatenate([both[:, reach:0:-1], both, both[:, -2 : -2 - reach : -1]], axis=1)
    sums = np.cumsum(np.pad(mirrored, ((0, 0), (1, 0))), axis=1)
    means = (sums[:, 2 * reach + 1 :] - sums[:, : -2 * reach - 1]) / (2 * reach + 1)
    return np.asarray(means[0] / np.maximum(means[1], LEAST_SHARE))


def information_criterion(residuals: np.ndarray, unknowns: int) -> float:
    """Compute the Bayesian information criterion of the coloured residuals (n,) that a fit of so many unknowns left.

    The terms of the autoregression count as unknowns too.
    """
    noise = autoregression(residuals, min(unknowns, residuals.size - 1))
    lost = (unknowns + noise.order) * float(np.log(residuals.size))
    return -2.0 * float(np.sum(log_likelihoods(noise, residuals))) + lost


def criterion_error(first: np.ndarray, second: np.ndarray) -> float:
    """Compute the standard error of the difference of two fits' criteria from the log-likelihoods (n,) of the samples.

    Of twice the sum of their differences (Q. H. Vuong, Econometrica 57:307, 1989), which may be correlated from sample
    to sample: with the weights of Newey and West (Econometrica 55:703, 1987) up to n^(1/3).
    """
    apart = first - second
    apart = apart - np.mean(apart)
    reach = round(apart.size ** (1.0 / 3.0))
    variance = float(apart @ apart)
    for lag in range(1, reach + 1):
        variance += 2.0 * (1.0 - lag / (reach + 1.0)) * float(apart[lag:] @ apart[:-lag])
    return 2.0 * float(np.sqrt(max(variance, 0.0)))


def autocorrelation(residuals: np.ndarray, lags: int) -> np.ndarray:
    """Compute the autocorrelation at lags 0 to ``lags`` of even residuals (n,)."""
    centred = residuals - np.mean(residuals)
    total = float(centred @ centred)
    if total == 0:
        return np.append(1.0, np.zeros(lags))
    return np.array([centred[k:] @ centred[: centred.size - k] / total for k in range(lags + 1)])
