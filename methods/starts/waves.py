"""A scan for the damped sine waves that fit the measurements best, as initial guesses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from bench import Channel, Force, Problem
from methods.starts.common_rates import MAX_CYCLES, gains, periodogram
from methods.starts.forced_motion import force_by_dof, forced_dofs, forced_motion
from methods.starts.search_range import most_cycles

DECAYS = (0.2, 1.0, 3.0, 8.0)
"""Decay rates of the grid, times the duration: from nearly undamped to decayed within an eighth of the record."""
PER_HALF_CYCLE = 4
"""Frequencies per half cycle per record."""
MOST_FORCED = 1_000_000
"""Oscillators times samples above which the force itself replaces the oscillators' responses in the scan."""
MOST_FREQUENCIES = 8192
"""Grid size above which only the frequencies of largest periodogram, an eighth as many, are scanned."""
MOST_SAMPLES = 1000
"""Samples per channel in the scan; longer channels are decimated."""
BLOCK = 2**21
"""Largest number of array entries of wave columns in memory."""
ORDER = {"displacement": 0, "velocity": 1, "acceleration": 2}
"""Order of the time derivative that a sensor measures."""


@dataclass(frozen=True, eq=False)
class Guess:
    """A damped wave ``exp(-decay t) (a cos(omega t) + b sin(omega t))`` as the initial guess of a fit.

    ``omega`` (rad per unit of time), ``decay`` (per unit of time); ``left`` is the sum of squared residuals over that
    of the data, with every channel scaled to unit size. ``logs`` are log-parameters known from an earlier fit. From a
    ``firm`` guess a fit applies the full weight of the physics from the beginning, with ``left`` as noise level.
    """

    omega: float
    decay: float
    left: float
    logs: np.ndarray | None = None
    firm: bool = False


def scan(problem: Problem, waves: int = 1, forced: bool = False, beyond: bool = False) -> tuple[list[Guess], float]:
    """Return the local minima over frequency of the best fit by one damped wave, best first (at least one).

    For every frequency and decay of a grid, the amplitudes of every channel, and its unknown offset, are fitted by
    linear least squares. The range of frequencies follows :mod:`methods.starts.search_range`.

    Args:
        problem: In natural units.
        waves: Number of waves fitted successively, for the residual share of the data.
        forced: Add the motion of an oscillator of that frequency and decay under the known forces, so that the first
            wave is the free vibration. For long records, where that takes longer than a fit, the force itself is added,
            to which a displacement is proportional under a slow force.
        beyond: Search above half the sampling rate too, for one linear mode that the prior supports there.

    Returns:
        The minima, and the residual share of the data after ``waves`` waves.
    """
    duration = max(record.duration for record in problem.records)
    n = max(channel.n for record in problem.records for channel in record.channels)
    one_mode = problem.system.linear and problem.system.n_dof == 1
    expected = problem if beyond and one_mode else replace(problem, prior=None)
    cycles = duration * most_cycles(expected, max(MAX_CYCLES, 0.5 * (n - 1) / duration))
    halves = np.arange(0.5, max(2.0 * cycles, 2) + 1e-9, 1.0 / PER_HALF_CYCLE)
    omegas, decays = np.pi * halves / duration, np.array(DECAYS) / duration
    if omegas.size > MOST_FREQUENCIES:
        omegas = omegas[_strongest(problem, omegas)]
    series = [
        _Series(c, record.forces if forced else (), omegas.size * decays.size)
        for record in problem.records
        for c in record.channels
        if c.n > 4 and np.any(c.values)
    ]
    guesses: list[Guess] = []
    left = 1.0
    for _ in range(waves):
        minima = _best(series, omegas, decays)
        guesses = guesses or minima
        left = minima[0].left
        if min((each.values.size - each.fixed.shape[1] for each in series), default=0) < 5:
            break
        for each in series:
            each.fix(minima[0])
    return guesses, left


def _strongest(problem: Problem, omegas: np.ndarray) -> np.ndarray:
    """Return the indices of the frequencies of a long grid with the largest power in the channels' periodograms."""
    power = np.zeros(omegas.size)
    for channel in (c for record in problem.records for c in record.channels if c.n > 4 and np.any(c.values)):
        frequencies, spectrum = periodogram(channel, channel.n, padding=2)
        power += np.interp(omegas, 2.0 * np.pi * frequencies, spectrum / spectrum.sum())
    return np.sort(np.argsort(power, kind="stable")[-MOST_FREQUENCIES // 8 :])


class _Series:
    """The values of a channel, and the columns fitted to them in addition to a wave: ``fixed`` (n, k)."""

    def __init__(self, channel: Channel, forces: Sequence[Force], oscillators: int) -> None:
        chosen = _thinned(channel.n)
        self.thinned = chosen.size < channel.n
        self.times, self.values = channel.times[chosen], channel.values[chosen]
        self.fixed = np.ones((self.times.size, int(channel.offset)))
        self.order = ORDER[channel.measures]
        self.forces = forces if forced_dofs(forces) else ()
        if oscillators * (channel.n + sum(f.times.size for f in forces)) > MOST_FORCED:
            self.forces = ()
            if forced_dofs(forces) and self.order == 0:
                self.fixed = np.hstack([self.fixed, force_by_dof(forces, self.times).T])

    def columns(self, omegas: np.ndarray, decays: np.ndarray) -> np.ndarray:
        """Return the columns of a wave, (n_omegas, n_decays, n, k): two for the wave, one per forced DOF."""
        waves = _wave(self.times, omegas, decays)
        if not self.forces:
            return waves
        key = tuple((f.times.tobytes(), f.values.tobytes(), str(f.hold), f.dof) for f in self.forces)
        plain = _forced(key, self.times.tobytes(), omegas.tobytes(), decays.tobytes())
        return np.concatenate([waves, plain[:, :, self.order]], -1)

    def fix(self, guess: Guess) -> None:
        """Append the columns of a wave to the fixed ones."""
        columns = self.columns(np.array([guess.omega]), np.array([guess.decay]))[0, 0]
        self.fixed = np.hstack([self.fixed, columns])


def _thinned(n: int) -> np.ndarray:
    """Return the indices of the samples of a scan: all n, or one from each of ``MOST_SAMPLES`` equal parts.

    The position within a part follows the golden ratio, since even decimation would alias fast motions.
    """
    if n <= MOST_SAMPLES:
        return np.arange(n)
    parts = np.arange(MOST_SAMPLES)
    return ((parts + parts * 0.5 * (np.sqrt(5.0) - 1.0) % 1.0) * n / MOST_SAMPLES).astype(int)


@lru_cache(maxsize=8)
def _forced(forces: tuple[tuple[bytes, bytes, str, int], ...], times: bytes, *grid: bytes) -> np.ndarray:
    """Call :func:`forced_motion` on a grid of frequencies and decays; cached, since replicates share their forces."""
    omegas, decays = (np.frombuffer(part) for part in grid)
    acting = [Force(np.frombuffer(t), np.frombuffer(v), hold, dof) for t, v, hold, dof in forces]  # type: ignore[arg-type]
    return forced_motion(acting, -decays + 1j * omegas[:, None], np.frombuffer(times))


def _best(series: list[_Series], omegas: np.ndarray, decays: np.ndarray) -> list[Guess]:
    """Return the local minima over frequency of the fit by fixed columns and one wave, best first."""
    left = np.zeros((omegas.size, decays.size))
    for each in series:
        left += _left(each, omegas, decays) / len(series)
    score, best = left.min(axis=1), left.argmin(axis=1)
    padded = np.concatenate([[np.inf], score, [np.inf]])
    minima = np.flatnonzero((score <= padded[:-2]) & (score < padded[2:]))
    order = minima[np.argsort(score[minima], kind="stable")]
    return [Guess(float(omegas[i]), float(decays[best[i]]), float(score[i])) for i in order]


def _wave(t: np.ndarray, omegas: np.ndarray, decays: np.ndarray) -> np.ndarray:
    """Return the two columns of each wave, (n_omegas, n_decays, n_times, 2)."""
    envelope = np.exp(-decays[:, None] * t)
    phase = omegas[:, None, None] * t
    return np.stack([envelope * np.cos(phase), envelope * np.sin(phase)], -1)


def _left(series: _Series, omegas: np.ndarray, decays: np.ndarray) -> np.ndarray:
    """Return the residual share of the sum of squares (n_omegas, n_decays) after fitting fixed columns and a wave.

    Decimated records, with many frequencies, use inner products; motions under forces are cached for the whole grid.
    """
    share = _left_by_products if series.thinned else _left_by_projection
    at_once = 1 if series.thinned else decays.size
    step = omegas.size if series.forces and not series.thinned else max(1, BLOCK // (at_once * series.times.size))
    return np.concatenate([share(series, omegas[i : i + step], decays) for i in range(0, omegas.size, step)])


def _left_by_projection(series: _Series, omegas: np.ndarray, decays: np.ndarray) -> np.ndarray:
    y, added = series.values, series.columns(omegas, decays)
    a = np.concatenate([np.broadcast_to(series.fixed, (*added.shape[:2], *series.fixed.shape)), added], -1)
    q, _ = np.linalg.qr(a)
    return np.asarray(np.maximum(1.0 - np.sum((y @ q) ** 2, -1) / (y @ y), 0.0))


def _left_by_products(series: _Series, omegas: np.ndarray, decays: np.ndarray) -> np.ndarray:
    y, basis = series.values, np.linalg.qr(series.fixed)[0].T
    taken = gains(series.times, y[None], basis, decays, omegas).T
    return np.asarray(np.maximum(1.0 - (np.sum((basis @ y) ** 2) + taken) / (y @ y), 0.0))
