"""Optimal sampling times: a c-optimal or D-optimal subset of a fine grid, averaged over the likely oscillators.

The exchange algorithm replaces one sample at a time until no exchange lowers the criterion (V. V. Fedorov, Theory of
Optimal Experiments, 1972), with rank-one updates of the inverse information. The criterion is the mean over the
oscillators of the logarithm of the variance of one quantity (c-optimal), or of the volume of the confidence ellipse of
k/m and c/m (D-optimal, with the initial state as nuisance parameters).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.planning.free_decay import QUANTITIES, Decay, errors, information, motion
from bench.planning.search import Likely

FINE = 16
"""Grid times per sample."""
MOST_GRID = 4000
VOLUME = "all"
"""The criterion of all quantities (D-optimality)."""
LEAST_GAIN = 1e-6
STARTS = 3
"""Number of random initial sets of times, in addition to the uniform one; the best result is used."""


@dataclass(frozen=True, eq=False)
class Times:
    """Sampling ``times`` (s), sorted, with the median error of each quantity over the likely oscillators."""

    times: np.ndarray
    median: dict[str, float]


def evaluate_times(likely: Likely, times: np.ndarray, amplitude: float) -> Times:
    """Return the errors for samples at given times (s), (n,)."""
    decay = Decay(times.size, float(times[-1]), amplitude)
    bounds = [errors(information(oscillator, decay, times)) for oscillator in likely.oscillators]
    return Times(times, {name: float(np.median([bound[name] for bound in bounds])) for name in QUANTITIES})


def best_times(likely: Likely, decay: Decay, quantity: str) -> Times:
    """Return the optimal times of ``decay.samples`` samples within its duration, for a quantity or :data:`VOLUME`."""
    size = min(FINE * (decay.samples - 1) + 1, max(MOST_GRID, decay.samples))
    grid = np.linspace(0.0, decay.duration, size)
    scaled = [motion(oscillator, grid, (decay.amplitude, 0.0))[1] for oscillator in likely.oscillators]
    scaled = [rows / np.linalg.norm(rows, axis=0) for rows in scaled]  # shifts the criterion by a constant only
    rows, rng = np.stack(scaled), np.random.default_rng(0)
    even = np.round(np.linspace(0, size - 1, decay.samples)).astype(int)
    starts = [even, *(rng.choice(size, decay.samples, replace=False) for _ in range(STARTS))]
    best = min((_Exchange(rows, start, quantity).run() for start in starts), key=lambda search: search.value)
    return evaluate_times(likely, grid[best.selected], decay.amplitude)


class _Exchange:
    """The exchange algorithm.

    ``rows`` (oscillators, grid, 4): derivatives at the times of the grid; ``selected`` (grid,): mask of the samples.
    """

    def __init__(self, rows: np.ndarray, start: np.ndarray, quantity: str) -> None:
        self.rows, self.selected = rows, np.zeros(rows.shape[1], bool)
        self.selected[start] = True
        self.columns = np.eye(4)[:, :2]
        if quantity != VOLUME:
            self.columns = np.array([[*QUANTITIES[quantity], 0.0, 0.0]]).T
        self.value = self._criterion(self._inverse(self.selected))

    def run(self) -> _Exchange:
        """Exchange samples until no exchange lowers the criterion."""
        while self.exchange():
            pass
        return self

    def exchange(self) -> bool:
        """Make one exchange that lowers the criterion, if possible, trying the least informative samples first."""
        without = np.where(self.selected, self._after(self._inverse(self.selected), -1.0), np.inf)
        for removed in np.argsort(without)[: int(self.selected.sum())]:
            selected = self.selected.copy()
            selected[removed] = False
            free = ~self.selected
            added = int(np.argmin(np.where(free, self._after(self._inverse(selected), 1.0), np.inf)))
            selected[added] = True
            value = self._criterion(self._inverse(selected))
            if value < self.value - LEAST_GAIN:
                self.selected, self.value = selected, value
                return True
        return False

    def _inverse(self, selected: np.ndarray) -> np.ndarray:
        rows = self.rows[:, selected]
        return np.linalg.inv(rows.swapaxes(1, 2) @ rows)

    def _criterion(self, inverse: np.ndarray) -> float:
        block = self.columns.T @ inverse @ self.columns
        return float(np.mean(np.linalg.slogdet(block)[1]))

    def _after(self, inverse: np.ndarray, sign: float) -> np.ndarray:
        """Return the criterion (grid,) after adding (``sign`` 1) or removing (-1) a sample at each time of the grid."""
        weighted = self.rows @ inverse
        share = np.sum(weighted * self.rows, axis=2)
        steps = weighted @ self.columns / np.sqrt(np.maximum(1.0 + sign * share, 1e-12))[..., None]
        block = (self.columns.T @ inverse @ self.columns)[:, None] - sign * steps[..., :, None] * steps[..., None, :]
        return np.asarray(np.mean(np.linalg.slogdet(block)[1], axis=0))
