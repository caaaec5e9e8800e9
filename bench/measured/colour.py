"""The colour of the noise: an autoregressive model of residuals, its spectrum, and whether they are white.

The residuals of a real record are seldom white: the model class is not quite right, the sensor drifts, the floor moves.
An autoregression of low order stands for their spectrum (G. E. P. Box, G. M. Jenkins, Time Series Analysis, 1970,
section 6.3; order by the Bayesian information criterion, G. Schwarz, Ann. Stat. 6:461, 1978).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

MOST_ORDER = 30
SAMPLES_PER_ORDER = 10
EVEN = 0.25
"""Largest departure of a sampling interval from their median, over that median, of times that pass for even here."""
NEIGHBOURS = 3
"""Fourier frequencies to either side over which a periodogram is smoothed."""
LEAST_SHARE = 0.2
"""Least part of the noise's power that counts as left by a fit near a frequency."""
KS_95 = 1.358
"""95 % point of the Kolmogorov statistic: half-width of the band of a cumulative periodogram times the root of n."""


@dataclass(frozen=True, eq=False)
class Autoregression:
    """``r_t = a_1 r_(t-1) + ... + a_p r_(t-p) + e_t`` with ``e`` white of the given variance; of order 0: white."""

    coefficients: np.ndarray
    variance: float

    @property
    def order(self) -> int:
        return int(self.coefficients.size)

    def spectrum(self, n: int) -> np.ndarray:
        """Variance by frequency, up to a constant, at the n // 2 + 1 frequencies of a transform of length n."""
        return np.asarray(self.variance / np.abs(np.fft.rfft(np.append(1.0, -self.coefficients), n)) ** 2)

    def autocovariance(self, n: int) -> np.ndarray:
        """At lags 0 to n - 1."""
        length = 1 << max(13, int(np.ceil(np.log2(4 * n))))
        return np.fft.irfft(self.spectrum(length), length)[:n]

    def whitened(self, values: np.ndarray) -> np.ndarray:
        """Prediction errors of (n, ...) values over their standard deviation; the first ones lack predecessors."""
        errors = values.copy()
        for lag, coefficient in enumerate(self.coefficients, 1):
            errors[lag:] -= coefficient * values[:-lag]
        return np.asarray(errors / np.sqrt(self.variance))

    def drawn(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Noise of this colour, shape (n,), through its spectrum: periodic over eight times the length."""
        length = 1 << int(np.ceil(np.log2(8 * max(n, 64))))
        white = np.fft.rfft(rng.standard_normal(length))
        return np.fft.irfft(white * np.sqrt(self.spectrum(length)), length)[:n]


def even_times(times: np.ndarray) -> bool:
    """Whether the samples follow each other at one interval."""
    steps = np.diff(times)
    middle = float(np.median(steps)) if steps.size else 0.0
    return steps.size > 1 and bool(np.max(np.abs(steps - middle)) <= EVEN * middle)


def autoregression(residuals: np.ndarray, used: float = 0.0) -> Autoregression:
    """The autoregression of even residuals (n,) by Levinson and Durbin, of the order with the least BIC.

    ``used``: degrees of freedom that the fit has spent, by which the residuals are smaller than the noise.
    """
    n = residuals.size
    centred = residuals - np.mean(residuals)
    most = max(0, min(MOST_ORDER, n // SAMPLES_PER_ORDER))
    lagged = np.array([centred[k:] @ centred[: n - k] / n for k in range(most + 1)])
    share = max(1.0 - used / n, 1.0 / n)
    variance, own = float(lagged[0]), np.zeros(0)
    if variance <= 0:
        return Autoregression(own, np.finfo(float).tiny)
    best, least = Autoregression(own, variance / share), n * np.log(variance)
    for order in range(1, most + 1):
        reflection = (lagged[order] - own @ lagged[order - 1 : 0 : -1]) / variance
        own = np.append(own - reflection * own[::-1], reflection)
        variance *= 1.0 - reflection**2
        if variance <= 0:
            break
        criterion = n * np.log(variance) + order * np.log(n)
        if criterion < least:
            best, least = Autoregression(own.copy(), variance / share), criterion
    return best


def local_spectrum(residuals: np.ndarray, slopes: np.ndarray, length: int) -> np.ndarray:
    """The spectrum (length // 2 + 1,) of noise by the periodogram of the residuals (n,) that a fit has left of it.

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


def log_likelihood(noise: Autoregression, residuals: np.ndarray) -> float:
    """Of residuals (n,) but the first :data:`MOST_ORDER`, given those, with the noise's variance at its best value.

    The same samples count whatever the order is, so that orders can be compared.
    """
    errors = noise.whitened(residuals - np.mean(residuals))[min(MOST_ORDER, residuals.size // SAMPLES_PER_ORDER) :]
    return float(-0.5 * errors.size * (np.log(2 * np.pi * np.mean(errors**2) * noise.variance) + 1.0))


def information_criterion(residuals: np.ndarray, unknowns: int) -> float:
    """The Bayesian information criterion of residuals (n,) that a fit of so many unknowns left, coloured as they are.

    The terms of the autoregression count as unknowns too.
    """
    noise = autoregression(residuals, min(unknowns, residuals.size - 1))
    return -2.0 * log_likelihood(noise, residuals) + (unknowns + noise.order) * float(np.log(residuals.size))


def periodogram(residuals: np.ndarray) -> np.ndarray:
    """Power of residuals (n,) at their Fourier frequencies without zero, shape (n // 2,); they add up to one."""
    power = np.abs(np.fft.rfft(residuals - np.mean(residuals))[1:]) ** 2
    total = float(np.sum(power))
    return power / total if total > 0 else power


def cumulative_periodogram(residuals: np.ndarray) -> tuple[np.ndarray, float]:
    """Cumulative power, and the half-width of the 95 % band about the straight line that white noise gives.

    M. S. Bartlett, An Introduction to Stochastic Processes, 1955, section 9.2.
    """
    power = np.cumsum(periodogram(residuals))
    return power, KS_95 / np.sqrt(max(power.size, 1))


def autocorrelation(residuals: np.ndarray, lags: int) -> np.ndarray:
    """At lags 0 to ``lags``, of even residuals (n,)."""
    centred = residuals - np.mean(residuals)
    total = float(centred @ centred)
    if total == 0:
        return np.append(1.0, np.zeros(lags))
    return np.array([centred[k:] @ centred[: centred.size - k] / total for k in range(lags + 1)])
