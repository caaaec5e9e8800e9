"""Free motion that goes on undisturbed, and where it does not: silence, a release, a hand, a jump, a drift.

Over a few cycles the free motion of one mode is close to a decaying sine about a constant, whatever its damping law or
spring: the best decaying sine of a bank, with its derivatives by frequency and damping beside it, leaves a few percent
of the motion even of a pendulum at 2 rad or a Duffing spring. At each place the residual sum of squares of one such
wave over both sides is compared with that of one wave on each side (G. C. Chow, Econometrica 28:591, 1960); a side
shorter than ``REACH`` is left unexplained (Chow's predictive test). The constants of the waves along the record show
the sensor's drift.

A change counts where it is large beside the motion (``SHARE``) and beside what noise of the record's own colour does
(``MEDIANS`` times the median over all places); both thresholds were chosen on clean simulated records, which stay
below.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.modal.waves import WaveFit
from bench.records.dominant_frequency import dominant_frequency

REACH = 2.0
"""Cycles on either side of a place."""
A_CYCLE = 12
"""Least samples of a cycle that denser ones are averaged to, which keeps white noise white."""
FEWEST_A_CYCLE = 5.0
"""Samples of a cycle below which a wave of five unknowns follows anything over two cycles."""
RATES, DECAYS = (
    part.ravel() for part in np.meshgrid(np.exp(np.linspace(-0.35, 0.35, 9)), (0.0, 0.05, 0.15, 0.4), indexing="ij")
)
"""Frequencies over the record's strongest, and damping ratios, of the waves in the bank."""
SHARE = 0.08
"""Least change over the energy of the motion around it; clean records of 13 kinds stay below 0.045."""
MEDIANS = 20.0
"""Least change over the median change in the record; of pure noise the largest of a thousand is 7 times the median."""
ALIVE, GOES_ON = 0.02, 0.3
"""Least energy around a place over the largest of the record, and least energy after it over that around it: elsewhere
the motion has died out."""
DRIFT_CYCLES, MOST_STRETCHES = 1.5, 100
"""Length of a stretch whose constant is one point of the line through a drift, and their largest number."""
FASTER, LIGHT, MODE = 1.25, 0.25, 0.3
"""Least rate of a second mode over the first, as slower ones are like a hand's motion; largest damping ratio of the
first, as a heavily damped one is like a jump; and the part of the misfit of one mode that two leave at most. There a
change is a mode that dies out."""
QUIET, DEPARTED, FLAT = 12, 10.0, 3.0
"""Least samples of silence; least size of the motion after it over its scatter; least length over the time in which
the motion then covers half of its way, 0.25 cycles of a release at rest."""
CURVED = 0.7
"""Least scatter of silence about a parabola over that about a constant: less is the motion near a turning point."""
JUMP, LEAST_NEAR = 6.0, 8
"""Second difference over the median of so many around it that is a jump of the value or of the slope."""
UNEXPLAINED = 1e-3
"""Part of the energy that a wave leaves of free motion of any kind. A change lies where it is largest over what is left
on both sides, which without noise would be nothing."""
CHUNK = 8192
"""Windows that are looked at together, which bounds the memory."""


@dataclass(frozen=True)
class EvenMotion:
    """Values (n,) at even ``times`` (s), with so many samples ``a_cycle`` of their strongest frequency."""

    times: np.ndarray
    values: np.ndarray
    a_cycle: float

    @property
    def step(self) -> float:
        return float(self.times[1] - self.times[0])


def silence(times: np.ndarray, values: np.ndarray) -> float | None:
    """Return when (s) a motion is released, after a stretch in which the sensor shows a constant; None without one.

    It is the place of the least information criterion of two variances, one before and one after it, up to half of the
    motion's size, as seismic arrivals are picked (N. Maeda, Zisin 38:365, 1985).

    Args:
        times: Times of the samples (s), shape (n,).
        values: Samples of one sensor, shape (n,).
    """
    away = np.abs(values - np.mean(values[:QUIET]))
    half = int(np.argmax(away > 0.5 * np.max(away)))
    places, end = np.arange(QUIET, half), half + 1
    if not places.size:
        return None
    least = (1e-4 * np.max(away)) ** 2  # rounded values have no scatter
    early = _scatter(values, 0 * places, places) / places + least
    late = _scatter(values, places, 0 * places + end) / (end - places) + least
    release = int(places[np.argmin(places * np.log(early) + (end - places) * np.log(late))])
    before, seconds = values[:release], times[:release]
    scatter = np.std(before)
    curve = np.std(before - np.polynomial.Polynomial.fit(seconds, before, 2)(seconds))
    size = np.median(np.abs(values[half : half + QUIET] - np.mean(before)))  # one sample far off is an outlier
    waited, rise = times[release - 1] - times[0], times[half] - times[release - 1]
    departs = scatter <= np.max(away) / DEPARTED and size > 3.0 * scatter
    return float(times[release]) if departs and curve >= CURVED * scatter and waited >= FLAT * rise else None


def changes(times: np.ndarray, values: np.ndarray) -> list[float]:
    """Return when (s) a free motion does not go on undisturbed; empty where it does, or where too little is known.

    Args:
        times: Times of the samples (s), shape (n,).
        values: Samples of one sensor, shape (n,).
    """
    from scipy.signal import find_peaks  # slow to import

    motion = _even(times, values)
    if motion is None or motion.a_cycle < FEWEST_A_CYCLE:
        return []
    n, reach = motion.values.size, round(REACH * motion.a_cycle)
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
    near = 0.75 * motion.a_cycle * motion.step
    return [
        _jump(times, values, float(motion.times[place] - 0.5 * motion.step), near)
        for place in peaks
        if not _second_mode(motion, max(place - reach, 0), place + 2 * reach)
    ]


def _jump(times: np.ndarray, values: np.ndarray, time: float, near: float) -> float:
    """Return when (s) the first sample lies that leaves the line through the two before it as far as none near does."""
    places = np.flatnonzero(np.abs(times[2:] - time) <= near) + 2
    if places.size < LEAST_NEAR:
        return time
    left = np.abs(values[places] - 2 * values[places - 1] + values[places - 2])
    first = places[int(np.argmax(left >= 0.6 * np.max(left)))]
    return float(times[first]) if np.max(left) > JUMP * np.median(left) else time


def _second_mode(motion: EvenMotion, first: int, last: int) -> bool:
    """Return whether a faster mode beside a lightly damped one leaves little of what one mode leaves of a stretch."""
    one = WaveFit.empty(motion.times[first:last], motion.values[None, first:last]).longer()
    two = one.longer()
    slow, fast = sorted(two.poles, key=lambda pole: float(pole.imag))
    leaves_little = np.sum(two.residuals**2) < MODE * np.sum(one.residuals**2)
    return bool(leaves_little and fast.imag > FASTER * slow.imag and -slow.real < LIGHT * slow.imag)


def drift(times: np.ndarray, values: np.ndarray) -> tuple[float, float] | None:
    """Return the slope (1/s) of a straight line under a free motion, and the p-value of none; None for too few cycles.

    The line goes through the constants of decaying sines, each fitted to one and a half cycles, whose scatter about it
    gives the standard error of the slope, whatever the noise's colour. Stretches in which the motion has died out are
    left aside: friction holds a mass away from its rest.
    """
    from scipy.stats import linregress

    motion = _even(times, values)
    if motion is None:
        return None
    count = min(max(int(motion.values.size / motion.a_cycle / DRIFT_CYCLES), 4), MOST_STRETCHES)
    n = motion.values.size // count
    windows = motion.values[: n * count].reshape(count, n)
    alive = np.var(windows, axis=1) >= ALIVE * np.max(np.var(windows, axis=1))
    if n < 8 or np.count_nonzero(alive) < 4:
        return None
    constants = _constants(windows[alive] - np.mean(motion.values), motion.a_cycle)
    line = linregress(motion.times[: n * count : n][alive], constants)
    return float(line.slope), float(line.pvalue)


def _even(times: np.ndarray, values: np.ndarray) -> EvenMotion | None:
    """Average neighbours so that ``A_CYCLE`` samples or more are left of a cycle; None for a straight line."""
    from scipy.interpolate import PchipInterpolator  # slow to import, and few records need it

    level = values - np.polynomial.Polynomial.fit(times, values, 1)(times)
    if not np.any(level):
        return None
    frequency = dominant_frequency(times, level)
    block = max(int((times.size - 1) / (float(np.ptp(times)) * frequency * A_CYCLE)), 1)
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
    """Return the sums of squares of the samples from ``first`` to before ``last`` (k,) about their means."""
    values = values - np.mean(values)
    sums, squares = (np.cumsum(np.append(0.0, part)) for part in (values, values**2))
    return np.maximum(squares[last] - squares[first] - (sums[last] - sums[first]) ** 2 / (last - first), 0.0)


def _misfit(motion: EvenMotion, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Return the residual sums of squares of the best wave from ``first`` to before ``last`` each, shape (k,)."""
    misfit = np.empty(first.size)
    for n in np.unique(last - first):
        bank = np.linalg.qr(_waves(n, 2 * np.pi / motion.a_cycle * RATES, DECAYS))[0]
        flat = bank.transpose(1, 0, 2).reshape(n, -1)
        rows = np.flatnonzero(last - first == n)
        for part in np.array_split(rows, rows.size // CHUNK + 1):
            windows = motion.values[first[part, None] + np.arange(n)]
            windows = windows - np.mean(windows, axis=1, keepdims=True)
            explained = np.sum((windows @ flat).reshape(part.size, len(bank), -1) ** 2, axis=2)
            misfit[part] = np.sum(windows**2, axis=1) - np.max(explained, axis=1)
    return misfit


def _constants(windows: np.ndarray, a_cycle: float) -> np.ndarray:
    """Return the constants (k,) of the decaying sines that are closest to windows (k, n), by Gauss and Newton."""
    turn, n = 2 * np.pi / a_cycle, windows.shape[1]
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
    """Return bases (k, n, 5): a constant, decaying sine and cosine, and their derivatives; ``turns``: rad a sample."""
    turns, decays, t = turns[:, None], decays[:, None], np.arange(n) - (n - 1) / 2
    size = np.exp(-decays * turns * (t - t[0]))
    cosine, sine = size * np.cos(turns * t), size * np.sin(turns * t)
    waves = np.stack([np.ones_like(size), cosine, sine, t * cosine, t * sine], axis=2)
    return np.asarray(waves)
