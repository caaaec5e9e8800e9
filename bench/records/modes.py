"""Modes of a free vibration: damped cosines and an offset, fitted to one channel, and their aliases.

A mode is added at the largest line of the residuals' periodogram while the line is significant (R. A. Fisher, Proc. R.
Soc. A 125:54, 1929) and large enough to matter; all modes, with their amplitudes and the offset, are then fitted anew.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bench.likelihood.autoregression import autoregression, even_times
from bench.records.strongest import strongest_frequency

LINE_LEVEL = 1e-6
"""Chance that white noise has such a line: far below that of a false alarm in a life of records."""
LINE_SHARE = 0.03
"""Least root mean square of a line over that of the signal: a mode below 3 % hardly moves the values of the others."""
BANDWIDTHS = 2.0
"""Half-power bandwidths of a mode within which a line in the residuals is what its fit has left."""
BEGINNINGS, LEAST_BEGINNING = (1, 4, 16), 100
"""Parts of the record in whose beginning lines are sought, and the least samples there."""
MOST_MODES = 4
"""More modes in one channel are a matter for modal analysis with several sensors."""
MOST_SAMPLES = 20_000
"""Samples from the release on that are fitted: the rest of a longer record is used by the main fit only."""
RATIOS = (0.003, 0.01, 0.03)
"""Damping ratios at which the search for a new mode starts: light damping, as of metal parts and of joints."""


@dataclass(frozen=True)
class OfferedMode:
    """Natural frequency (Hz) and damping ratio, each with the 95 % interval of this record.

    ``share``: root mean square of the mode over that of the signal. ``alias``: a frequency that would give the same
    samples as the mode above it.
    """

    frequency: float
    frequency_low: float
    frequency_high: float
    damping_ratio: float
    damping_ratio_low: float
    damping_ratio_high: float
    share: float
    alias: bool = False


@dataclass(frozen=True, eq=False)
class ModalFit:
    """Damped cosines and a constant, with the amplitudes of least squares, beside samples ``values`` (n,).

    ``times`` (n,) from 0 on; ``poles`` (2, m): decay rates and angular frequencies.
    """

    times: np.ndarray
    values: np.ndarray
    poles: np.ndarray

    @cached_property
    def basis(self) -> np.ndarray:
        """Cosines, sines and ones, shape (n, 2 m + 1)."""
        envelopes, phases = np.exp(-np.outer(self.times, self.poles[0])), np.outer(self.times, self.poles[1])
        return np.column_stack([envelopes * np.cos(phases), envelopes * np.sin(phases), np.ones(self.times.size)])

    @cached_property
    def amplitudes(self) -> np.ndarray:
        """Those of cosines, sines and the constant, shape (2 m + 1,)."""
        return np.asarray(np.linalg.lstsq(self.basis, self.values, rcond=None)[0])

    @cached_property
    def residuals(self) -> np.ndarray:
        return np.asarray(self.values - self.basis @ self.amplitudes)

    @property
    def misfit(self) -> float:
        """Sum of squares of the residuals."""
        return float(self.residuals @ self.residuals)

    @property
    def slopes(self) -> np.ndarray:
        """Derivatives (n, 2 m) of the motion by decay rates and angular frequencies."""
        m, t = self.poles.shape[1], self.times[:, None]
        cosines, sines, (a, b) = self.basis[:, :m], self.basis[:, m:-1], self.amplitudes[:-1].reshape(2, m)
        return np.column_stack([-t * (cosines * a + sines * b), t * (cosines * b - sines * a)])

    def refined(self) -> ModalFit:
        """Return the least-squares fit of all poles, searched for from those of this fit.

        By variable projection (G. H. Golub, V. Pereyra, SIAM J. Numer. Anal. 10:413, 1973), with the Jacobian of L.
        Kaufman, BIT 15:49, 1975.
        """
        from scipy.optimize import least_squares  # slow to import, and few records need it

        def at(x: np.ndarray) -> ModalFit:
            return replace(self, poles=x.reshape(2, -1))

        def jacobian(x: np.ndarray) -> np.ndarray:
            fit = at(x)
            q, slopes = np.linalg.qr(fit.basis)[0], fit.slopes
            return np.asarray(q @ (q.T @ slopes) - slopes)

        rates = self.poles[1]
        lowest, scale = np.repeat([0.0, 1e-6 * rates[-1]], rates.size), np.concatenate([0.01 * rates, rates])
        start = np.maximum(self.poles.ravel(), lowest + 1e-12 * rates[-1])
        search = least_squares(lambda x: at(x).residuals, start, jacobian, (lowest, np.inf), x_scale=scale, max_nfev=60)
        return at(search.x)

    def modes(self) -> tuple[OfferedMode, ...]:
        """Return the modes, the strongest first, with intervals from the residuals as coloured as they are."""
        from scipy.linalg import matmul_toeplitz
        from scipy.stats import t as student

        slopes = np.column_stack([self.slopes, self.basis])
        n, unknowns = slopes.shape
        noise = autoregression(self.residuals, unknowns)
        inverse = np.linalg.pinv(slopes)
        covariance = inverse @ matmul_toeplitz(noise.autocovariance(n), inverse.T)
        quantile, modes = float(student.ppf(0.975, max(n - unknowns, 1))), []
        m = self.poles.shape[1]
        for i, (s, w) in enumerate(self.poles.T):
            rate, places = float(np.hypot(s, w)), [i, m + i]
            by = np.array([[s / rate, w / rate], [w**2 / rate**3, -s * w / rate**3]])
            halves = quantile * np.sqrt(np.diag(by @ covariance[np.ix_(places, places)] @ by.T))
            f, half, ratio = rate / (2 * np.pi), float(halves[0]) / (2 * np.pi), float(s / rate)
            share = float(np.std(self.basis[:, places] @ self.amplitudes[places]) / (np.std(self.values) or 1.0))
            ends = max(ratio - float(halves[1]), 0.0), ratio + float(halves[1])
            modes.append(OfferedMode(f, f - half, f + half, ratio, *ends, share))
        return tuple(sorted(modes, key=lambda mode: -mode.share))


def modes_of(times: np.ndarray, values: np.ndarray, most: int = MOST_MODES) -> tuple[OfferedMode, ...]:
    """Fit up to ``most`` modes to samples (n,) at times (n,); the strongest first, none where a fit fails."""
    fits = modal_fits(times, values, most)
    return fits[-1].modes() if fits else ()


def modal_fits(times: np.ndarray, values: np.ndarray, most: int) -> list[ModalFit]:
    """Fit one mode, two, and so on up to ``most``, as long as a further one is significant."""
    t, y = times[:MOST_SAMPLES] - times[0], values[:MOST_SAMPLES]
    fits: list[ModalFit] = []
    while len(fits) < most and y.size > 6 * (len(fits) + 1):
        poles = fits[-1].poles if fits else np.zeros((2, 0))
        frequency, share = line(t, fits[-1].residuals, y) if fits else (strongest_frequency(t, y), 1.0)
        rate = 2 * np.pi * frequency
        if share < LINE_SHARE or np.any(np.abs(rate - poles[1]) < BANDWIDTHS * 2 * poles[0]):
            break
        starts = [ModalFit(t, y, np.column_stack([poles, [ratio * rate, rate]])) for ratio in RATIOS]
        fits.append(min(starts, key=lambda start: start.misfit).refined())
    return fits


def line(times: np.ndarray, residuals: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    """Return frequency (1/time) and root mean square, over that of the values, of a significant line; 0 if none is.

    It is sought in the whole record and in its beginning, where a mode that soon dies out is seen better.
    """
    parts = [slice(0, times.size // part) for part in BEGINNINGS if times.size // part >= LEAST_BEGINNING or part == 1]
    return max((_line(times[part], residuals[part], values[part]) for part in parts), key=lambda line: line[1])


def _line(times: np.ndarray, residuals: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    even = np.interp(np.linspace(times[0], times[-1], times.size), times, residuals)
    power = np.abs(np.fft.rfft(even - np.mean(even))[1:]) ** 2
    total, size = float(np.sum(power)), float(np.std(values))
    if not (total > 0 and size > 0):
        return 0.0, 0.0
    largest = float(np.max(power)) / total
    frequency = (int(np.argmax(power)) + 1) / float(np.ptp(times))
    chance = power.size * (1.0 - largest) ** (power.size - 1)
    return (frequency, float(np.std(residuals)) * np.sqrt(largest) / size) if chance < LINE_LEVEL else (frequency, 0.0)


def alias_of(mode: OfferedMode, times: np.ndarray) -> OfferedMode | None:
    """Return the lowest frequency above a mode's that would give the same even samples, with its damping ratio."""
    if not even_times(times):
        return None
    rate = (times.size - 1) / float(np.ptp(times))
    decay = mode.damping_ratio * mode.frequency
    damped = rate - float(np.sqrt(max(mode.frequency**2 - decay**2, 0.0)))
    frequency = float(np.hypot(damped, decay))
    half = (mode.frequency_high - mode.frequency_low) / 2.0
    scale = mode.frequency / frequency
    return OfferedMode(
        frequency,
        frequency - half,
        frequency + half,
        scale * mode.damping_ratio,
        scale * mode.damping_ratio_low,
        scale * mode.damping_ratio_high,
        mode.share,
        alias=True,
    )
