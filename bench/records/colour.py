"""Coloured residuals: their spectrum, autocorrelation and information criterion.

The residuals of a real record are seldom white: the model is approximate, the sensor drifts, the floor moves.
"""

from __future__ import annotations

import numpy as np

from bench.likelihood.autoregression import autoregression, log_likelihoods

NEIGHBOURS = 3
"""Fourier frequencies on either side over which a periodogram is smoothed."""
LEAST_SHARE = 0.2
"""Lower limit of the share of the noise power that remains in the residuals near a frequency."""


def local_spectrum(residuals: np.ndarray, slopes: np.ndarray, length: int) -> np.ndarray:
    """Compute the spectrum of noise from the smoothed periodogram of the residuals of a fit.

    A fit removes the noise along its derivatives, which lie near the natural frequency, where the noise matters most.
    The smoothed periodogram is divided by the smoothed share that remains at each frequency, which makes it unbiased
    where the spectrum is flat (for the smoothing: M. B. Priestley, Spectral Analysis and Time Series, 1981, section
    6.2).

    Args:
        residuals: Residuals at even times, shape (n,).
        slopes: Derivatives of the prediction, shape (n, p).
        length: Length of the transform.

    Returns:
        The variance by frequency, shape (length // 2 + 1,).
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
    """Compute the Bayesian information criterion of coloured residuals (n,) of a fit with a number of unknowns.

    The coefficients of the autoregression are counted as unknowns.
    """
    noise = autoregression(residuals, min(unknowns, residuals.size - 1))
    penalty = (unknowns + noise.order) * float(np.log(residuals.size))
    return -2.0 * float(np.sum(log_likelihoods(noise, residuals))) + penalty


def criterion_error(first: np.ndarray, second: np.ndarray) -> float:
    """Compute the standard error of the difference of the criteria of two fits.

    It is that of twice the sum of the differences of the log-likelihoods (Q. H. Vuong, Econometrica 57:307, 1989),
    which are correlated: Newey and West (Econometrica 55:703, 1987), up to the lag n^(1/3).

    Args:
        first: Log-likelihoods of the samples, shape (n,).
        second: Those of the other fit, shape (n,).
    """
    difference = first - second
    difference = difference - np.mean(difference)
    lags = round(difference.size ** (1.0 / 3.0))
    variance = float(difference @ difference)
    for lag in range(1, lags + 1):
        variance += 2.0 * (1.0 - lag / (lags + 1.0)) * float(difference[lag:] @ difference[:-lag])
    return 2.0 * float(np.sqrt(max(variance, 0.0)))


def autocorrelation(residuals: np.ndarray) -> float:
    """Compute the autocorrelation at lag 1 of residuals (n,) at even times; 0 if they are constant."""
    centred = residuals - np.mean(residuals)
    total = float(centred @ centred)
    return float(centred[1:] @ centred[:-1] / total) if total > 0 else 0.0
