"""Detection of disturbances of a free motion: rest before a release, contact by a hand, jumps, drift of the sensor.

Over a few cycles the free motion of one mode is close to a decaying sine plus a constant, whatever the damping law or
spring: the best sine of a bank, with its derivatives by frequency and damping, fits even a pendulum at 2 rad or a
Duffing spring to a few percent. At each sample the residual sum of squares of one such wave on both sides is compared
with that of separate waves on either side (G. C. Chow, Econometrica 28:591, 1960); a side shorter than ``REACH`` is
not fitted (Chow's predictive test). The constants of the waves along the record show the drift of the sensor.

A change is significant if it is large relative to the motion (``SHARE``) and to the effect of noise (``MEDIANS`` times
the median over the record). Both thresholds were chosen so that clean simulated records remain below them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.modal.waves import WaveFit
from bench.records.dominant_frequency import dominant_frequency

REACH = 2.0
"""Cycles on either side of a sample that are compared."""
PER_CYCLE = 12
"""Least samples per cycle after averaging, which keeps white noise white."""
FEWEST_PER_CYCLE = 5.0
"""Samples per cycle below which a wave of five unknowns fits any data over two cycles."""
RATES, DECAYS = (
    part.ravel() for part in np.meshgrid(np.exp(np.linspace(-0.35, 0.35, 9)), (0.0, 0.05, 0.15, 0.4), indexing="ij")
)
"""Frequencies of the waves in the bank over the dominant one, and their damping ratios."""
SHARE = 0.08
"""Threshold of a change over the energy of the motion nearby; clean records of 13 kinds remain below 0.045."""
MEDIANS = 20.0
"""Threshold of a change over the median change in the record; for noise the largest of a thousand is 7 medians."""
ALIVE, GOES_ON = 0.02, 0.3
"""Least energy near a sample over the largest in the record, and least energy after it over that on both sides: below
either, the motion has died out."""
DRIFT_CYCLES, MOST_STRETCHES = 1.5, 100
"""Length of the segments whose constants are fitted by a line, and their largest number."""
FASTER, LIGHT, MODE = 1.25, 0.25, 0.3
"""A change is due to a second mode, which decays faster, if the frequency ratio of the modes is at least ``FASTER``
(slower motions may be those of a hand), the first damping ratio is at most ``LIGHT`` (a heavily damped wave resembles a
jump), and two modes have at most the fraction ``MODE`` of the residual sum of squares of one."""
QUIET, DEPARTED, FLAT = 12, 10.0, 3.0
"""Least samples of a rest; least amplitude after it over its scatter; least duration over the time in which the motion
then reaches half of its amplitude, which is 0.25 cycles for a release at rest."""
CURVED = 0.7
"""Least scatter of a rest about a parabola over that about a constant; below it the motion is at a turning point."""
JUMP, LEAST_NEAR = 6.0, 8
"""Second difference over the median nearby at which a value or slope jumps, and the least number of samples nearby."""
UNEXPLAINED = 1e-3
"""Fraction of the energy added to the residuals of both sides before the ratio of a change to them is maximised, as
they vanish without noise."""
CHUNK = 8192
"""Number of windows processed together, which bounds the memory."""


@dataclass(frozen=True)
class EvenMotion:
    """Values (n,) at even ``times`` (s), with ``per_cycle`` samples per period of the dominant frequency."""

    times: np.ndarray
    values: np.ndarray
    per_cycle: float

    @property
    def step(self) -> float:
        return float(self.times[1] - self.times[0])


def silence(times: np.ndarray, values: np.ndarray) -> float | None:
    """Return the time (s) at which a motion is released after a rest; None if the record does not begin at rest.

    The release minimises the information criterion of two variances, before and after it, up to half of the amplitude,
    as in picking of seismic arrivals (N. Maeda, Zisin 38:365, 1985).

    Args:
        times: Times of the samples (s), shape (n,).
        values: Samples of one sensor, shape (n,).
    """
    distance = np.abs(values - np.mean(values[:QUIET]))
    half = int(np.argmax(distance > 0.5 * np.max(distance)))
    candidates, end = np.arange(QUIET, half), half + 1
    if not candidates.size:
        return None
    floor = (1e-4 * np.max(distance)) ** 2  # rounded values may have no scatter
    early = _scatter(values, 0 * candidates, candidates) / candidates + floor
    late = _scatter(values, candidates, 0 * candidates + end) / (end - candidates) + floor
    release = int(candidates[np.argmin(candidates * np.log(early) + (end - candidates) * np.log(late))])
    before, seconds = values[:release], times[:release]
    scatter = np.std(before)
    curve = np.std(before - np.polynomial.Polynomial.fit(seconds, before, 2)(seconds))
    size = np.median(np.abs(values[half : half + QUIET] - np.mean(before)))  # the median ignores single outliers
    waiting, rise = times[release - 1] - times[0], times[half] - times[release - 1]
    departs = scatter <= np.max(distance) / DEPARTED and size > 3.0 * scatter
    return float(times[release]) if departs and curve >= CURVED * scatter and waiting >= FLAT * rise else None


def changes(times: np.ndarray, values: np.ndarray) -> list[float]:
    """Return the times (s) at which a free motion is disturbed; empty also if the record is too short to tell.

    Args:
        times: Times of the samples (s), shape (n,).
        values: Samples of one sensor, shape (n,).
    """
    from scipy.signal import find_peaks  # slow to import

    motion = _even(times, values)
    if motion is None or motion.per_cycle < FEWEST_PER_CYCLE:
        return []
    n, reach = motion.values.size, round(REACH * motion.per_cycle)
    if n < 1.5 * reach:
        return []
    places = np.arange(n)
    first, last = np.maximum(places - reach, 0), np.minimum(places + reach, n)
    before, after = places >= reach, places <= n - reach
    sides = np.zeros(n)
    sides[before] += _misfit(motion, first[before], places[before])
    sides[after] += _misfit(motion, places[after], last[after])
    change = _misfit(motion, first, last) - sides
    energy = _scatter(motion.values, first, last)
    rest = _scatter(motion.values, places, last) * (last - first) / (last - places)
    typical = np.median(change[before & after]) if n >= 3 * reach else np.median(change)
    counts = (energy >= ALIVE * np.max(energy)) & (rest >= GOES_ON * energy)
    counts &= (change >= SHARE * energy) & (change >= MEDIANS * typical)
    sharp = np.where(counts, change / np.maximum(sides + UNEXPLAINED * energy, np.finfo(float).tiny), 0.0)
    peaks = find_peaks(np.pad(sharp, 1), distance=2 * reach)[0] - 1
    near = 0.75 * motion.per_cycle * motion.step
    return [
        _jump(times, values, float(motion.times[place] - 0.5 * motion.step), near)
        for place in peaks
        if not _second_mode(motion, max(place - reach, 0), place + 2 * reach)
    ]


def _jump(times: np.ndarray, values: np.ndarray, time: float, near: float) -> float:
    """Return the time (s) of a jump within ``near`` (s) of a time, by the second difference; the time if none jumps."""
    nearby = np.flatnonzero(np.abs(times[2:] - time) <= near) + 2
    if nearby.size < LEAST_NEAR:
        return time
    differences = np.abs(values[nearby] - 2 * values[nearby - 1] + values[nearby - 2])
    first = nearby[int(np.argmax(differences >= 0.6 * np.max(differences)))]
    return float(times[first]) if np.max(differences) > JUMP * np.median(differences) else time


def _second_mode(motion: EvenMotion, first: int, last: int) -> bool:
    """Return whether a segment is explained by a faster second mode besides a lightly damped first one."""
    single = WaveFit.empty(motion.times[first:last], motion.values[None, first:last]).longer()
    double = single.longer()
    slow, fast = sorted(double.poles, key=lambda pole: float(pole.imag))
    fits_better = np.sum(double.residuals**2) < MODE * np.sum(single.residuals**2)
    return bool(fits_better and fast.imag > FASTER * slow.imag and -slow.real < LIGHT * slow.imag)


def drift(times: np.ndarray, values: np.ndarray) -> tuple[float, float] | None:
    """Estimate a linear drift under a free motion.

    A line is fitted to the constants of decaying sines, each fitted to one and a half cycles; their scatter about it
    gives the standard error for noise of any colour. Segments in which the motion has died out are excluded, as
    friction may hold a mass away from its equilibrium.

    Args:
        times: Times of the samples (s), shape (n,).
        values: Samples of one sensor, shape (n,).

    Returns:
        The slope (1/s) and the p-value of no drift; None for too few cycles.
    """
    from scipy.stats import linregress

    motion = _even(times, values)
    if motion is None:
        return None
    count = min(max(int(motion.values.size / motion.per_cycle / DRIFT_CYCLES), 4), MOST_STRETCHES)
    n = motion.values.size // count
    windows = motion.values[: n * count].reshape(count, n)
    alive = np.var(windows, axis=1) >= ALIVE * np.max(np.var(windows, axis=1))
    if n < 8 or np.count_nonzero(alive) < 4:
        return None
    constants = _constants(windows[alive] - np.mean(motion.values), motion.per_cycle)
    line = linregress(motion.times[: n * count : n][alive], constants)
    return float(line.slope), float(line.pvalue)


def _even(times: np.ndarray, values: np.ndarray) -> EvenMotion | None:
    """Average samples in blocks of at least ``PER_CYCLE`` per cycle, at even times; None for a straight line."""
    from scipy.interpolate import PchipInterpolator  # slow to import, and few records need it

    level = values - np.polynomial.Polynomial.fit(times, values, 1)(times)
    if not np.any(level):
        return None
    frequency = dominant_frequency(times, level)
    block = max(int((times.size - 1) / (float(np.ptp(times)) * frequency * PER_CYCLE)), 1)
    n = times.size // block
    times, values = (part[: n * block].reshape(n, block).mean(axis=1) for part in (times, values))
    steps = np.diff(times)
    step = float(np.median(steps))
    if np.max(np.abs(steps - step)) < 0.02 * step:
        step = float(np.mean(steps))
        return EvenMotion(times[0] + step * np.arange(n), values, 1 / (frequency * step))
    even = np.arange(times[0], times[-1], step)
    return EvenMotion(even, PchipInterpolator(times, values)(even), 1 / (frequency * step))


def _scatter(values: np.ndarray, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Return the sums of squares about their means of the samples [first, last), both of shape (k,)."""
    values = values - np.mean(values)
    sums, squares = (np.cumsum(np.append(0.0, part)) for part in (values, values**2))
    return np.maximum(squares[last] - squares[first] - (sums[last] - sums[first]) ** 2 / (last - first), 0.0)


def _misfit(motion: EvenMotion, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Return the residual sums of squares (k,) of the best wave in the bank over the samples [first, last)."""
    misfit = np.empty(first.size)
    for n in np.unique(last - first):
        bank = np.linalg.qr(_waves(n, 2 * np.pi / motion.per_cycle * RATES, DECAYS))[0]
        flat = bank.transpose(1, 0, 2).reshape(n, -1)
        rows = np.flatnonzero(last - first == n)
        for part in np.array_split(rows, rows.size // CHUNK + 1):
            windows = motion.values[first[part, None] + np.arange(n)]
            windows = windows - np.mean(windows, axis=1, keepdims=True)
            explained = np.sum((windows @ flat).reshape(part.size, len(bank), -1) ** 2, axis=2)
            misfit[part] = np.sum(windows**2, axis=1) - np.max(explained, axis=1)
    return misfit


def _constants(windows: np.ndarray, per_cycle: float) -> np.ndarray:
    """Fit decaying sines to windows (k, n) by the Gauss-Newton method; return their constants (k,)."""
    turn, n = 2 * np.pi / per_cycle, windows.shape[1]
    bank = np.linalg.qr(_waves(n, turn * RATES, DECAYS))[0]
    best = np.argmax(np.sum((np.swapaxes(bank, 1, 2) @ windows.T) ** 2, axis=1), axis=0)
    turns, decays = turn * RATES[best], DECAYS[best]
    for _ in range(4):
        fit = np.linalg.pinv(_waves(n, turns, decays)) @ windows[:, :, None]
        constants, a, b, da, db = fit[:, :, 0].T
        size = np.maximum(a * a + b * b, np.finfo(float).tiny)
        rates = decays * turns - np.clip((a * da + b * db) / size, -0.1 * turns, 0.1 * turns)
        turns = turns + np.clip((b * da - a * db) / size, -0.1 * turns, 0.1 * turns)
        decays = rates / turns
    return np.asarray(constants)


def _waves(n: int, turns: np.ndarray, decays: np.ndarray) -> np.ndarray:
    """Return bases (k, n, 5): constant, decaying cosine and sine, their derivatives; ``turns`` in rad per sample."""
    turns, decays, t = turns[:, None], decays[:, None], np.arange(n) - (n - 1) / 2
    size = np.exp(-decays * turns * (t - t[0]))
    cosine, sine = size * np.cos(turns * t), size * np.sin(turns * t)
    waves = np.stack([np.ones_like(size), cosine, sine, t * cosine, t * sine], axis=2)
    return np.asarray(waves)
