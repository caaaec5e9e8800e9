"""Forces of a given energy: a hammer blow, noise, an even multisine, and those that tell most, robust over the likely
oscillators.

A pulse is half a sine, whose duration is sought. A multisine has lines at multiples of 1/duration; its powers are best
in steady state (:mod:`bench.planning.multisine`), its phases drawn. Best of all is a force whose lines are free in
power and phase, sought on the finite record with its transient and its unknown start: the information is quadratic in
the force (G. Goodwin, R. Payne, Dynamic System Identification, 1977, chapter 6), so the search is local, from several
starts. Each is judged by the information of the finite record.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.planning.forced_test import FORCED_QUANTITIES, ForcedTest, derivatives, forced_errors, free_motions
from bench.planning.multisine import best_powers, wanted_columns
from bench.planning.search import Likely

BLOW = 0.05
"""Duration of a hammer blow, in periods; at least two sampling intervals, or no sample would show it."""
WIDTHS = np.geomspace(0.1, 6.0, 60)
"""Durations of pulses that are tried, in periods."""
BAND = 2.0
"""The highest line over the highest frequency that is likely."""
NYQUIST = 0.8
"""The highest line at most, over half the sampling rate: force and motion are linear between samples."""
DRAWS = 20
"""Noises, of which the median one counts, and sets of phases, of which the best one does."""
LEAST_LINES = 3
ITERATIONS = 300


@dataclass(frozen=True, eq=False)
class ForceInformation:
    """A ``force`` (n,), and by quantity the median error over the likely oscillators."""

    force: np.ndarray
    median: dict[str, float]


def told_by(likely: Likely, test: ForcedTest, force: np.ndarray) -> ForceInformation:
    """What a test under a force of any size tells, brought to the energy of the test."""
    scaled = test.scaled(force)
    every = [forced_errors(own, test, scaled) for own in likely.oscillators]
    return ForceInformation(
        scaled, {name: float(np.median([one[name] for one in every])) for name in FORCED_QUANTITIES}
    )


def line_frequencies(likely: Likely, test: ForcedTest) -> np.ndarray:
    """The lines of a multisine (Hz)."""
    highest = min(BAND * likely.fastest, NYQUIST * 0.5 / test.interval)
    return np.arange(1, int(highest * test.duration + 1e-9) + 1) / test.duration


def half_sine(test: ForcedTest, width: float) -> np.ndarray:
    """Half a sine of a duration (s), from the first sample on."""
    return np.where(test.times < width, np.sin(np.pi * test.times / width), 0.0)


class Forces:
    """Forces of one test; ``quantity`` is what the best ones tell best, or :data:`ALL`."""

    def __init__(self, likely: Likely, test: ForcedTest) -> None:
        self.likely, self.test = likely, test
        self.frequencies = line_frequencies(likely, test)
        angles = 2.0 * np.pi * np.outer(test.times, self.frequencies)
        self.basis = np.concatenate([np.cos(angles), np.sin(angles)], axis=1)
        self.motions = [derivatives(own, test.times, self.basis) for own in likely.oscillators]
        self.starts = [free_motions(own, test.times) for own in likely.oscillators]

    def hammer_blow(self) -> np.ndarray:
        """A short half sine."""
        return half_sine(self.test, max(BLOW / self.likely.frequency, 2.0 * self.test.interval))

    def noise(self, quantity: str) -> np.ndarray:
        """Gaussian noise of the band: of :data:`DRAWS`, the one that is median for a quantity."""
        rng = np.random.default_rng(0)
        drawn = [self.basis @ rng.standard_normal(self.basis.shape[1]) for _ in range(DRAWS)]
        return sorted(drawn, key=lambda force: self.value(force, quantity))[DRAWS // 2]

    def even_multisine(self, quantity: str) -> np.ndarray:
        """The same power in each line of the band."""
        return self._phased(np.full(self.frequencies.size, 1.0 / self.frequencies.size), quantity)

    def best_pulse(self, quantity: str) -> np.ndarray:
        """Half a sine of the best duration."""
        widths = [width for width in WIDTHS / self.likely.frequency if 2.0 * self.test.interval <= width]
        pulses = [half_sine(self.test, width) for width in widths if width <= self.test.duration]
        return min([self.hammer_blow(), *pulses], key=lambda force: self.value(force, quantity))

    def best_multisine(self, quantity: str) -> np.ndarray:
        """A multisine whose powers are best in steady state."""
        powers = best_powers(self.likely.oscillators, self.frequencies, quantity)
        return self._phased(powers.shares, quantity)

    def best(self, quantity: str) -> np.ndarray:
        """Of the band, what tells most in the finite record: the best end of searches from the other forces."""
        starts = [self.best_multisine(quantity), self.best_pulse(quantity), self.noise(quantity)]
        found = [self._climbed(start, quantity) for start in starts]
        return min(found, key=lambda force: self.value(force, quantity))

    def value(self, force: np.ndarray, quantity: str) -> float:
        """The criterion of a force, at the energy of the test: the mean logarithm of the variance or volume."""
        scaled = self.test.scaled(force)
        columns, found = wanted_columns(quantity, 5), []
        for own, start in zip(self.likely.oscillators, self.starts, strict=True):
            rows = derivatives(own, self.test.times, scaled[:, None])[:, :, 0].T
            found.append(_criterion(np.concatenate([rows, start], axis=1), columns)[0])
        return float(np.mean(found))

    def _phased(self, shares: np.ndarray, quantity: str) -> np.ndarray:
        """A multisine of some powers, with the best of :data:`DRAWS` sets of phases."""
        rng, sizes = np.random.default_rng(0), np.sqrt(shares)
        phases = rng.uniform(0.0, 2.0 * np.pi, (DRAWS, sizes.size))
        forces = [self.basis @ np.concatenate([sizes * np.cos(own), sizes * np.sin(own)]) for own in phases]
        return min(forces, key=lambda force: self.value(force, quantity))

    def _climbed(self, force: np.ndarray, quantity: str) -> np.ndarray:
        """Where a local search over the lines of the band ends, from a force."""
        from scipy.optimize import minimize  # slow to import

        start = np.linalg.lstsq(self.basis, force, rcond=None)[0]
        columns = wanted_columns(quantity, 5)
        found = minimize(
            self._with_gradient, start / np.linalg.norm(start), (columns,), "L-BFGS-B", True,
            options={"maxiter": ITERATIONS, "maxcor": 20},
        )  # fmt: skip
        return np.asarray(self.basis @ found.x)

    def _with_gradient(self, lines: np.ndarray, columns: np.ndarray) -> tuple[float, np.ndarray]:
        """The criterion, whatever the size of the force, and its gradient by the lines (2 lines,)."""
        value, gradient = 0.0, np.zeros_like(lines)
        for motions, start in zip(self.motions, self.starts, strict=True):
            own, slope = _criterion(np.concatenate([(motions @ lines).T, start], axis=1), columns)
            value += own / len(self.motions)
            gradient += np.einsum("np,pnq->q", slope[:, :3], motions) / len(self.motions)
        force = self.basis @ lines
        energy, size = self.test.energy_of(force), columns.shape[1]
        padded = np.concatenate([[0.0], force, [0.0]])
        slope = padded[:-2] + 4.0 * force + padded[2:]
        slope[[0, -1]] -= 2.0 * force[[0, -1]]
        gradient += size * self.basis.T @ slope * (self.test.interval / 3.0) / energy
        return value + size * float(np.log(energy / self.test.energy)), gradient


def _criterion(rows: np.ndarray, columns: np.ndarray) -> tuple[float, np.ndarray]:
    """The log volume (squared) of what is wanted by derivatives (n, p) of unit noise, and its gradient by them."""
    scale = np.linalg.norm(rows, axis=0)  # columns of one size: the inverse is as exact as it can be
    scaled, weights = rows / scale, columns / scale[:, None]
    inverse = np.linalg.inv(scaled.T @ scaled)
    wanted = inverse @ weights
    block = weights.T @ wanted
    slope = -2.0 * scaled @ wanted @ np.linalg.solve(block, wanted.T) / scale
    return float(np.linalg.slogdet(block)[1]), slope
