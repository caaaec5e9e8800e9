"""Sampling times that tell most: a c-optimal or D-optimal subset of a fine grid, robust over the likely oscillators.

One sample is taken away and one put in at a time, until no exchange lowers the criterion (V. V. Fedorov, Theory of
Optimal Experiments, 1972; by rank-one updates of the inverse information). The criterion is the mean over the
oscillators of the logarithm of the variance of the wanted quantity (c-optimal), or of the volume of the ellipse of k/m
and c/m (D-optimal, the start being a nuisance).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.planning.free_decay import QUANTITIES, Decay, errors, information, motion
from bench.planning.search import Likely

FINE = 16
"""Grid times for each sample."""
MOST_GRID = 4000
VOLUME = "all"
"""The criterion that favours no quantity."""
LEAST_GAIN = 1e-6
STARTS = 3
"""Random sets of times from which exchanges begin, beside the even one; the best end counts."""


@dataclass(frozen=True, eq=False)
class Times:
    """Sampling ``times`` (s), sorted, and by quantity the median error over the likely oscillators."""

    times: np.ndarray
    median: dict[str, float]


def told_by(likely: Likely, times: np.ndarray, amplitude: float) -> Times:
    """What samples at some times tell."""
    decay = Decay(times.size, float(times[-1]), amplitude)
    every = [errors(information(own, decay, times)) for own in likely.oscillators]
    return Times(times, {name: float(np.median([one[name] for one in every])) for name in QUANTITIES})


def best_times(likely: Likely, decay: Decay, quantity: str) -> Times:
    """The best ``decay.samples`` times up to its duration for a quantity, or :data:`VOLUME`, from its uniform ones."""
    size = min(FINE * (decay.samples - 1) + 1, max(MOST_GRID, decay.samples))
    grid = np.linspace(0.0, decay.duration, size)
    scaled = [motion(own, grid, (decay.amplitude, 0.0))[1] for own in likely.oscillators]
    scaled = [rows / np.linalg.norm(rows, axis=0) for rows in scaled]  # the criterion differs by a constant
    rows, rng = np.stack(scaled), np.random.default_rng(0)
    even = np.round(np.linspace(0, size - 1, decay.samples)).astype(int)
    starts = [even, *(rng.choice(size, decay.samples, replace=False) for _ in range(STARTS))]
    best = min((_Exchange(rows, start, quantity).ended() for start in starts), key=lambda search: search.value)
    return told_by(likely, grid[best.taken], decay.amplitude)


class _Exchange:
    """``rows`` (oscillators, grid, 4): derivatives at each time of the grid; ``taken``: which are sampled."""

    def __init__(self, rows: np.ndarray, start: np.ndarray, quantity: str) -> None:
        self.rows, self.taken = rows, np.zeros(rows.shape[1], bool)
        self.taken[start] = True
        self.columns = np.eye(4)[:, :2]
        if quantity != VOLUME:
            self.columns = np.array([[*QUANTITIES[quantity], 0.0, 0.0]]).T
        self.value = self._criterion(self._inverse(self.taken))

    def ended(self) -> _Exchange:
        """Itself, once no exchange lowers the criterion."""
        while self.exchange():
            pass
        return self

    def exchange(self) -> bool:
        """Make an exchange that lowers the criterion, the least missed sample first; whether there was one."""
        lost = np.where(self.taken, self._after(self._inverse(self.taken), -1.0), np.inf)
        for out in np.argsort(lost)[: int(self.taken.sum())]:
            taken = self.taken.copy()
            taken[out] = False
            free = ~self.taken
            into = int(np.argmin(np.where(free, self._after(self._inverse(taken), 1.0), np.inf)))
            taken[into] = True
            value = self._criterion(self._inverse(taken))
            if value < self.value - LEAST_GAIN:
                self.taken, self.value = taken, value
                return True
        return False

    def _inverse(self, taken: np.ndarray) -> np.ndarray:
        own = self.rows[:, taken]
        return np.linalg.inv(own.swapaxes(1, 2) @ own)

    def _criterion(self, inverse: np.ndarray) -> float:
        block = self.columns.T @ inverse @ self.columns
        return float(np.mean(np.linalg.slogdet(block)[1]))

    def _after(self, inverse: np.ndarray, sign: float) -> np.ndarray:
        """The criterion with one more (``sign`` 1) or one less (-1) of each grid time, (grid,)."""
        moved = self.rows @ inverse
        share = np.sum(moved * self.rows, axis=2)
        steps = moved @ self.columns / np.sqrt(np.maximum(1.0 + sign * share, 1e-12))[..., None]
        block = (self.columns.T @ inverse @ self.columns)[:, None] - sign * steps[..., :, None] * steps[..., None, :]
        return np.asarray(np.mean(np.linalg.slogdet(block)[1], axis=0))
