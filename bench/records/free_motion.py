"""Free motion that goes on undisturbed, and the samples at which it does not: a release, a hand, a jump, another run.

Over a few cycles the free motion of one mode is close to a decaying sine about a constant, whatever its damping law or
spring: the best decaying sine of a bank, with its derivatives by frequency and damping beside it, leaves a few percent
of the motion even of a pendulum at 2 rad or a Duffing spring. At a place ``b`` the residual sum of squares of one such
wave over both sides is compared with that of one wave on each side (G. C. Chow, Econometrica 28:591, 1960). Near the
ends of a record the shorter side is left unexplained (Chow's predictive test).

A change counts where it is large beside the motion (``SHARE``) and beside what noise of the record's own colour does
(``MEDIANS`` times the median over all places); both thresholds were chosen on clean simulated records, which stay
below.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.records.strongest import strongest_frequency

REACH = 2.0
"""Cycles on either side of a place."""
A_CYCLE = 12
"""Least samples of a cycle that denser ones are averaged to, which keeps white noise white."""
FEWEST_A_CYCLE = 5.0
"""Samples of a cycle below which a wave of five unknowns follows anything over two cycles."""
RATES = np.exp(np.linspace(-0.35, 0.35, 9))
DECAYS = (0.0, 0.05, 0.15, 0.4)
"""Frequencies over the record's strongest, and damping ratios, of the waves in the bank."""
SHARE = 0.08
"""Least change over the energy of the motion around it; clean records of 13 kinds stay below 0.045."""
MEDIANS = 20.0
"""Least change over the median change in the record; of pure noise the largest of a thousand is 7 times the median."""
ALIVE = 0.02
"""Least energy around a place, over the largest of the record: elsewhere the motion has died out."""
DRIFT_CYCLES, MOST_STRETCHES = 1.5, 100
"""Length of a stretch whose constant is one point of the line through a drift, and their largest number."""
SECOND_RATES = (1.3, 0.1)
"""Lowest rate of a second mode over the first, and the step to the next; slower ones are like the hand's motion."""
MODE = 0.3
"""Part of the misfit of one wave left by a second one, below which the change is a mode that dies out."""
QUIET, DEPARTED, FLAT = 12, 10.0, 3.0
"""Least samples of silence; least size of the motion after it over its scatter; least length over the time in which
the motion then covers half of its way, 0.25 cycles of a release at rest."""
JUMP, LEAST_NEAR = 6.0, 8
"""Second difference over the median of so many around it that is a jump of the value or of the slope."""
CHUNK = 8192


@dataclass(frozen=True)
class Cut:
    """A place (s) where free motion does not go on, and how large the change is over the motion around it."""

    time: float
    share: float


def silence(times: np.ndarray, values: np.ndarray) -> float | None:
    """Return when (s) a motion is released, after a stretch in which the sensor shows a constant; None without one.

    Args:
        times: Times of the samples (s), shape (n,).
        values: Samples of one sensor, shape (n,).
    """
    last = QUIET
    for _ in range(50):
        level, scatter = float(np.mean(values[:last])), float(np.std(values[:last]))
        away = np.abs(values - level)
        if scatter > np.max(away) / DEPARTED:
            return None
        half = int(np.argmax(away > 0.5 * np.max(away)))
        quiet = np.flatnonzero(away[:half] <= 3.0 * scatter)
        if quiet.size == 0 or (new := int(quiet[-1]) + 1) == last:
            break
        last = max(new, QUIET)
    if np.median(away[half : half + QUIET]) <= 3.0 * scatter:  # one sample far off is an outlier, not a release
        return None
    early, late = np.mean(values[: last // 2]), np.mean(values[last // 2 : last])
    waited, rise = times[last - 1] - times[0], times[min(half, times.size - 1)] - times[last - 1]
    if last <= QUIET or abs(late - early) > scatter or waited < FLAT * rise:
        return None
    return float(times[last])


def first_change(times: np.ndarray, values: np.ndarray) -> Cut | None:
    """Return the largest change of a free motion, None where it goes on undisturbed or too little is known.

    Args:
        times: Times of the samples (s), shape (n,).
        values: Samples of one sensor, shape (n,).
    """
    level = values - np.polynomial.Polynomial.fit(times, values, 1)(times)
    if not np.any(level):
        return None
    frequency, samples = strongest_frequency(times, level), (times, values)
    times, values = _even(times, values, frequency)
    step = float(times[1] - times[0])
    reach = round(REACH / (frequency * step))
    if values.size < 1.5 * reach or frequency * step * FEWEST_A_CYCLE > 1.0:
        return None
    change, energy, after = _changes(values, reach, 2 * np.pi * frequency * step)
    typical = float(np.median(change[reach:-reach])) if values.size >= 3 * reach else float(np.median(change))
    counts = (energy >= ALIVE * np.max(energy)) & (change >= MEDIANS * typical) & (after >= 0.3 * energy)
    share = np.where(counts, change / np.maximum(energy, np.finfo(float).tiny), 0.0)
    if np.max(share) < SHARE:
        return None
    place = int(np.argmax(np.where(share >= SHARE, change, 0.0)))
    if _second_mode(values[max(place - reach, 0) : place + 2 * reach], 2 * np.pi * frequency * step) < MODE:
        return None
    if place < reach:  # what is left unexplained grows with the place: the first that leaves out nearly all of it
        place = int(np.argmax(change[: place + 1] >= 0.9 * change[place]))
    elif place > values.size - reach:
        place = values.size - 1 - int(np.argmax(change[: place - 1 : -1] >= 0.5 * change[place]))
    return Cut(_jump(*samples, float(times[place] - 0.5 * step), 0.75 / frequency), float(np.max(share)))


def _jump(times: np.ndarray, values: np.ndarray, time: float, near: float) -> float:
    """Return when (s) the first sample lies that leaves the line through the two before it as far as none near does."""
    places = np.flatnonzero(np.abs(times[2:] - time) <= near) + 2
    if places.size < LEAST_NEAR:
        return time
    left = np.abs(values[places] - 2 * values[places - 1] + values[places - 2])
    first = places[int(np.argmax(left >= 0.6 * np.max(left)))]
    return float(times[first]) if np.max(left) > JUMP * np.median(left) else time


@dataclass(frozen=True)
class SensorDrift:
    """Slope (1/s) of a straight line under a free motion, and the p-value of no slope."""

    slope: float
    p_value: float


def drift(times: np.ndarray, values: np.ndarray) -> SensorDrift | None:
    """Fit a line through the constants of decaying sines, each fitted to one and a half cycles; None for too few.

    The scatter of the constants about the line gives the standard error of its slope, whatever the noise's colour.
    Stretches in which the motion has died out are left aside: friction holds a mass away from its rest.
    """
    from scipy.stats import t as student

    level = values - np.polynomial.Polynomial.fit(times, values, 1)(times)
    if not np.any(level):
        return None
    frequency = strongest_frequency(times, level)
    times, values = _even(times, values, frequency)
    step = float(times[1] - times[0])
    count = min(max(int(values.size * frequency * step / DRIFT_CYCLES), 4), MOST_STRETCHES)
    n, turn = values.size // count, 2 * np.pi * frequency * step
    if n < 8:
        return None
    waves = [(turn * rate, decay) for rate in RATES for decay in DECAYS]
    bank = np.stack([_wave(n, *wave) for wave in waves])
    windows = (values[: n * count] - np.mean(values)).reshape(count, n)
    alive = np.var(windows, axis=1) >= ALIVE * np.max(np.var(windows, axis=1))
    places, windows = (np.arange(count) * n * step)[alive], windows[alive]
    if places.size < 4:
        return None
    best = np.argmax(np.sum(np.einsum("kip,wi->wkp", bank, windows) ** 2, axis=2), axis=1)
    constants = np.array([_constant(w, *waves[k]) for k, w in zip(best, windows, strict=True)])
    away = places - np.mean(places)
    slope = float(away @ constants / (away @ away))
    left = constants - np.mean(constants) - slope * away
    error = float(np.sqrt(left @ left / (places.size - 2) / (away @ away)))
    return SensorDrift(slope, 0.0 if error == 0 else float(2 * student.sf(abs(slope) / error, places.size - 2)))


def _constant(values: np.ndarray, turn: float, decay: float) -> float:
    """Return the constant of the decaying sine that is closest to the values (n,), by Gauss and Newton's method."""
    constant = 0.0
    for _ in range(4):
        columns = _columns(values.size, turn, decay)
        constant, a, b, da, db = np.linalg.lstsq(columns, values, rcond=None)[0]
        size = a * a + b * b or 1.0
        rate = decay * turn - float(np.clip((a * da + b * db) / size, -0.1 * turn, 0.1 * turn))
        turn += float(np.clip((b * da - a * db) / size, -0.1 * turn, 0.1 * turn))
        decay = rate / turn
    return float(constant)


def _even(times: np.ndarray, values: np.ndarray, frequency: float) -> tuple[np.ndarray, np.ndarray]:
    """Return values at even times: means of so many neighbours that ``A_CYCLE`` samples or more are left of a cycle."""
    from scipy.interpolate import PchipInterpolator  # slow to import, and few records need it

    block = max(int((times.size - 1) / (float(np.ptp(times)) * frequency * A_CYCLE)), 1)
    n = times.size // block
    times, values = (part[: n * block].reshape(n, block).mean(axis=1) for part in (times, values))
    steps = np.diff(times)
    step = float(np.median(steps))
    if np.max(np.abs(steps - step)) < 0.02 * step:
        return times[0] + np.mean(steps) * np.arange(n), values
    even = np.arange(times[0], times[-1], step)
    return even, PchipInterpolator(times, values)(even)


def _changes(values: np.ndarray, reach: int, turn: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return change, energy around and energy after each place from 0 to n - 1, each (n,), sums of squares a sample.

    ``turn``: angle of the strongest frequency from one sample to the next (rad).
    """
    n = values.size
    change, energy, after = np.zeros(n), np.zeros(n), np.zeros(n)
    windows = np.lib.stride_tricks.sliding_window_view
    sides = _left(windows(values, reach), turn)
    if n >= 2 * reach:
        both = windows(values, 2 * reach)
        inner = slice(reach, n - reach + 1)
        change[inner] = _left(both, turn) - sides[: both.shape[0]] - sides[reach : reach + both.shape[0]]
        energy[inner] = 2 * reach * np.var(both, axis=1)
        after[inner] = 2 * reach * np.var(windows(values[reach:], reach), axis=1)
    for place in range(1, min(reach, n - reach)):
        early, late = values[None, : reach + place], values[None, n - reach - place :]
        change[place] = _left(early, turn)[0] - sides[place]
        change[n - place] = _left(late, turn)[0] - sides[n - reach - place]
        energy[place], after[place] = early.size * np.var(early), early.size * np.var(values[place : place + reach])
        energy[n - place], after[n - place] = (
            late.size * np.var(late),
            late.size * np.mean((values[n - place :] - np.mean(late)) ** 2),
        )
    return np.maximum(change, 0.0), energy, after


def _left(windows: np.ndarray, turn: float) -> np.ndarray:
    """Return the least residual sum of squares of each window (k, n) over the waves of the bank, shape (k,)."""
    n = windows.shape[1]
    bank = np.stack([_wave(n, turn * rate, decay) for rate in RATES for decay in DECAYS])
    flat = bank.transpose(1, 0, 2).reshape(n, -1)
    least = []
    for first in range(0, len(windows), CHUNK):
        part = windows[first : first + CHUNK]
        part = part - np.mean(part, axis=1, keepdims=True)
        explained = np.sum((part @ flat).reshape(len(part), len(bank), -1) ** 2, axis=2)
        least.append(np.sum(part**2, axis=1) - np.max(explained, axis=1))
    return np.concatenate(least)


def _second_mode(values: np.ndarray, turn: float) -> float:
    """Return the part of one wave's residual sum of squares that a second, faster one leaves; values (n,)."""
    values = values - np.mean(values)
    faster = np.arange(SECOND_RATES[0], 0.95 * np.pi / turn, SECOND_RATES[1])
    banks = [
        np.stack([_wave(values.size, turn * rate, decay) for rate in rates for decay in decays])
        for rates, decays in ((RATES, DECAYS), (faster, (0.0, 0.02, *DECAYS[1:])))
    ]
    waves = [_best(banks[0], values), np.zeros(values.size)]
    left = float(np.sum((values - waves[0]) ** 2))
    for _ in range(4):
        waves[1] = _best(banks[1], values - waves[0])
        waves[0] = _best(banks[0], values - waves[1])
    return float(np.sum((values - waves[0] - waves[1]) ** 2)) / left if left > 0 else 1.0


def _best(bank: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the wave of a bank (k, n, 5) that is closest to the values (n,)."""
    sizes = np.einsum("kip,i->kp", bank, values)
    best = int(np.argmax(np.sum(sizes**2, axis=1)))
    return np.asarray(bank[best] @ sizes[best])


def _wave(n: int, turn: float, decay: float) -> np.ndarray:
    """Return an orthonormal basis (n, 5): a constant, a decaying sine and cosine, and their derivatives."""
    columns = _columns(n, turn, decay)
    return np.asarray(np.linalg.qr(columns / np.linalg.norm(columns, axis=0))[0])


def _columns(n: int, turn: float, decay: float) -> np.ndarray:
    t = np.arange(n) - (n - 1) / 2
    size = np.exp(-decay * turn * (t - t[0]))
    cosine, sine = size * np.cos(turn * t), size * np.sin(turn * t)
    return np.stack([np.ones(n), cosine, sine, t * cosine, t * sine], axis=1)
