"""Modes of a free vibration: damped cosines and an offset, fitted to one channel, and their aliases.

Amplitudes and offset are linear and eliminated (variable projection: G. H. Golub, V. Pereyra, SIAM J. Numer. Anal.
10:413, 1973; the Jacobian by L. Kaufman, BIT 15:49, 1975). A mode is added at the largest line of the residuals'
periodogram while the line is significant (R. A. Fisher, Proc. R. Soc. A 125:54, 1929) and large enough to matter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bench.likelihood.autoregression import even_times
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
CORRELATED_CYCLES = 2.0
"""Cycles of the slowest mode over which residuals may be correlated."""


@dataclass(frozen=True)
class Mode:
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


def modes_of(times: np.ndarray, values: np.ndarray, most: int = MOST_MODES) -> tuple[Mode, ...]:
    """Fit up to ``most`` modes to samples (n,) at times (n,); the strongest first, none where a fit fails."""
    t, y = times[:MOST_SAMPLES] - times[0], values[:MOST_SAMPLES]
    poles, residuals = np.zeros((0, 2)), y - np.mean(y)
    while len(poles) < most and y.size > 6 * (len(poles) + 1):
        frequency, share = line(t, residuals, y) if len(poles) else (strongest_frequency(t, residuals), 1.0)
        near = np.abs(2 * np.pi * frequency - poles[:, 1]) < BANDWIDTHS * 2 * poles[:, 0]
        if share < LINE_SHARE or np.any(near):
            break
        added = _search(t, y, poles, 2 * np.pi * frequency)
        if added is None:
            break
        poles, residuals = added, y - _fitted(t, y, added)
    return _modes(t, y, poles) if len(poles) else ()


def line(times: np.ndarray, residuals: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    """Return frequency (1/time) and root mean square, over that of the values, of a significant line; 0 if none is.

    It is sought in the whole record and in its beginning, where a mode that soon dies out is seen better.
    """
    parts = [slice(0, times.size // part) for part in BEGINNINGS if times.size // part >= LEAST_BEGINNING or part == 1]
    lines = [_line(times[part], residuals[part], values[part]) for part in parts]
    return max(lines, key=lambda found: found[1])


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


def alias_of(mode: Mode, times: np.ndarray) -> Mode | None:
    """Return the lowest frequency above a mode's that would give the same even samples, with its damping ratio."""
    if not even_times(times):
        return None
    rate = (times.size - 1) / float(np.ptp(times))
    decay = mode.damping_ratio * mode.frequency
    damped = rate - float(np.sqrt(max(mode.frequency**2 - decay**2, 0.0)))
    frequency = float(np.hypot(damped, decay))
    half = (mode.frequency_high - mode.frequency_low) / 2.0
    scale = mode.frequency / frequency
    return replace(
        mode,
        frequency=frequency,
        frequency_low=frequency - half,
        frequency_high=frequency + half,
        damping_ratio=scale * mode.damping_ratio,
        damping_ratio_low=scale * mode.damping_ratio_low,
        damping_ratio_high=scale * mode.damping_ratio_high,
        alias=True,
    )


def _basis(t: np.ndarray, poles: np.ndarray) -> np.ndarray:
    """Cosines and sines (n, 2 m + 1) of modes with decay rates and angular frequencies ``poles`` (m, 2), and ones."""
    envelopes = np.exp(-np.outer(t, poles[:, 0]))
    phases = np.outer(t, poles[:, 1])
    return np.column_stack([envelopes * np.cos(phases), envelopes * np.sin(phases), np.ones(t.size)])


def _fitted(t: np.ndarray, y: np.ndarray, poles: np.ndarray) -> np.ndarray:
    basis = _basis(t, poles)
    return np.asarray(basis @ np.linalg.lstsq(basis, y, rcond=None)[0])


def _slopes(t: np.ndarray, basis: np.ndarray, amplitudes: np.ndarray) -> np.ndarray:
    """Derivatives (n, 2 m) of the fitted motion by the decay rates and the angular frequencies."""
    m = (basis.shape[1] - 1) // 2
    cosines, sines, a, b = basis[:, :m], basis[:, m : 2 * m], amplitudes[:m], amplitudes[m : 2 * m]
    return np.column_stack([-t[:, None] * (cosines * a + sines * b), t[:, None] * (cosines * b - sines * a)])


def _search(t: np.ndarray, y: np.ndarray, poles: np.ndarray, rate: float) -> np.ndarray | None:
    """Least squares over all poles, with a new one at this angular frequency; None where it does not converge."""
    from scipy.optimize import least_squares

    m = len(poles) + 1

    def parts(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        basis = _basis(t, x.reshape(2, m).T)
        q, r = np.linalg.qr(basis)
        return basis, q, np.linalg.lstsq(r, q.T @ y, rcond=None)[0], y

    def residuals(x: np.ndarray) -> np.ndarray:
        basis, _, amplitudes, _ = parts(x)
        return np.asarray(basis @ amplitudes - y)

    def jacobian(x: np.ndarray) -> np.ndarray:
        basis, q, amplitudes, _ = parts(x)
        slopes = _slopes(t, basis, amplitudes)
        return np.asarray(slopes - q @ (q.T @ slopes))

    starts = [np.concatenate([poles.T, [[ratio * rate], [rate]]], axis=1).ravel() for ratio in RATIOS]
    start = min(starts, key=lambda x: float(np.sum(residuals(x) ** 2)))
    lowest = np.concatenate([np.zeros(m), np.full(m, 1e-6 * rate)])
    scale = np.concatenate([np.full(m, 0.01), np.ones(m)]) * np.tile(start[m:], 2)
    found = least_squares(
        residuals, np.maximum(start, lowest + 1e-12 * rate), jacobian, (lowest, np.inf), x_scale=scale, max_nfev=60
    )
    return found.x.reshape(2, m).T if np.all(np.isfinite(found.x)) else None


def _modes(t: np.ndarray, y: np.ndarray, poles: np.ndarray) -> tuple[Mode, ...]:
    """Modes at fitted poles, with intervals from the coloured residuals."""
    from scipy.stats import t as student

    m, basis = len(poles), _basis(t, poles)
    amplitudes = np.linalg.lstsq(basis, y, rcond=None)[0]
    residuals = y - basis @ amplitudes
    slopes = np.column_stack([_slopes(t, basis, amplitudes), basis])
    step = float(t[-1]) / (t.size - 1)
    covariance = _covariance(slopes, residuals, int(CORRELATED_CYCLES * 2 * np.pi / np.min(poles[:, 1]) / step))
    quantile, modes = float(student.ppf(0.975, max(t.size - slopes.shape[1], 1))), []
    for i, (s, w) in enumerate(poles):
        rate = float(np.hypot(s, w))
        by = np.array([[s / rate, w / rate], [w**2 / rate**3, -s * w / rate**3]])
        half = quantile * np.sqrt(np.diag(by @ covariance[np.ix_([i, m + i], [i, m + i])] @ by.T))
        f, f_half, ratio = rate / (2 * np.pi), float(half[0]) / (2 * np.pi), s / rate
        motion = basis[:, [i, m + i]] @ amplitudes[[i, m + i]]
        low = float(max(ratio - half[1], 0.0))
        share = float(np.std(motion) / np.std(y))
        modes.append(Mode(f, f - f_half, f + f_half, float(ratio), low, float(ratio + half[1]), share))
    return tuple(sorted(modes, key=lambda mode: -mode.share))


def _covariance(slopes: np.ndarray, residuals: np.ndarray, lags: int) -> np.ndarray:
    """Covariance (p, p) of a least-squares fit: assuming white noise, or a sandwich where that is larger.

    W. K. Newey, K. D. West, Econometrica 55:703, 1987.
    """
    n, p = slopes.shape
    sizes = np.linalg.norm(slopes, axis=0)
    rows = slopes / sizes
    bread = np.linalg.pinv(rows.T @ rows)
    scores = rows * residuals[:, None]
    meat = scores.T @ scores
    for lag in range(1, min(lags, n // 4)):
        product = scores[lag:].T @ scores[:-lag]
        meat += (1.0 - lag / lags) * (product + product.T)
    white = bread * float(residuals @ residuals)
    coloured = bread @ meat @ bread * n
    widening = np.sqrt(np.maximum(np.diag(coloured) / np.diag(white), 1.0))
    return np.asarray(white * np.outer(widening, widening) / np.outer(sizes, sizes) / max(n - p, 1))
