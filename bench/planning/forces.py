"""Forces of a given energy: hammer blow, noise, uniform multisine, and optimal forces for the likely oscillators.

The optimal pulse is a half sine of the best duration. The optimal multisine has lines at multiples of 1/duration, the
powers that are optimal in steady state (:mod:`bench.planning.multisine`), and random phases. The optimal force has
lines of free power and phase, optimised on the finite record including the transient and the unknown initial state. Its
information is quadratic in the force (G. Goodwin, R. Payne, Dynamic System Identification, 1977, chapter 6), so the
search is local, from several starting points. All forces are compared by the information of the finite record.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.planning.forced_test import FORCED_QUANTITIES, ForcedTest, derivatives, forced_errors, free_motions
from bench.planning.multisine import best_powers, criterion_columns
from bench.planning.search import Likely

BLOW = 0.05
"""Duration of a hammer blow, in periods; at least two sampling intervals are used, so that it is sampled."""
WIDTHS = np.geomspace(0.1, 6.0, 60)
"""Candidate durations of pulses, in periods."""
BAND = 2.0
"""Highest line of a multisine over the highest likely frequency."""
NYQUIST = 0.8
"""Upper limit of the highest line over half the sampling rate, since forces are linear between samples."""
DRAWS = 20
"""Number of random noises, of which the median one is used, and of random sets of phases, of which the best is used."""
LEAST_LINES = 3
ITERATIONS = 300


@dataclass(frozen=True, eq=False)
class ForceInformation:
    """A ``force`` (n,) with the median error of each quantity over the likely oscillators."""

    force: np.ndarray
    median: dict[str, float]


def evaluate_force(likely: Likely, test: ForcedTest, force: np.ndarray) -> ForceInformation:
    """Return the errors of a test under a force (n,), scaled to the energy of the test."""
    scaled = test.scale(force)
    bounds = [forced_errors(oscillator, test, scaled) for oscillator in likely.oscillators]
    return ForceInformation(
        scaled, {name: float(np.median([bound[name] for bound in bounds])) for name in FORCED_QUANTITIES}
    )


def line_frequencies(likely: Likely, test: ForcedTest) -> np.ndarray:
    """Return the frequencies of the lines of a multisine (Hz)."""
    highest = min(BAND * likely.fastest, NYQUIST * 0.5 / test.interval)
    return np.arange(1, int(highest * test.duration + 1e-9) + 1) / test.duration


def half_sine(test: ForcedTest, width: float) -> np.ndarray:
    """Return a half-sine pulse of duration ``width`` (s) that begins at the first sample."""
    return np.where(test.times < width, np.sin(np.pi * test.times / width), 0.0)


class Forces:
    """Forces of a test; ``quantity`` is the quantity to be optimised, or :data:`ALL`."""

    def __init__(self, likely: Likely, test: ForcedTest) -> None:
        self.likely, self.test = likely, test
        self.frequencies = line_frequencies(likely, test)
        angles = 2.0 * np.pi * np.outer(test.times, self.frequencies)
        self.basis = np.concatenate([np.cos(angles), np.sin(angles)], axis=1)
        self.motions = [derivatives(oscillator, test.times, self.basis) for oscillator in likely.oscillators]
        self.free = [free_motions(oscillator, test.times) for oscillator in likely.oscillators]

    def hammer_blow(self) -> np.ndarray:
        """Return a short half sine."""
        return half_sine(self.test, max(BLOW / self.likely.frequency, 2.0 * self.test.interval))

    def noise(self, quantity: str) -> np.ndarray:
        """Return band-limited Gaussian noise: the median of :data:`DRAWS` realisations for the quantity."""
        rng = np.random.default_rng(0)
        drawn = [self.basis @ rng.standard_normal(self.basis.shape[1]) for _ in range(DRAWS)]
        return sorted(drawn, key=lambda force: self.value(force, quantity))[DRAWS // 2]

    def even_multisine(self, quantity: str) -> np.ndarray:
        """Return a multisine of equal power in all lines."""
        return self._phased(np.full(self.frequencies.size, 1.0 / self.frequencies.size), quantity)

    def best_pulse(self, quantity: str) -> np.ndarray:
        """Return a half sine of the optimal duration."""
        widths = [width for width in WIDTHS / self.likely.frequency if 2.0 * self.test.interval <= width]
        pulses = [half_sine(self.test, width) for width in widths if width <= self.test.duration]
        return min([self.hammer_blow(), *pulses], key=lambda force: self.value(force, quantity))

    def best_multisine(self, quantity: str) -> np.ndarray:
        """Return a multisine with the powers that are optimal in steady state."""
        powers = best_powers(self.likely.oscillators, self.frequencies, quantity)
        return self._phased(powers.shares, quantity)

    def best(self, quantity: str) -> np.ndarray:
        """Return the optimal force on the finite record: the best result of local searches from the other forces."""
        starts = [self.best_multisine(quantity), self.best_pulse(quantity), self.noise(quantity)]
        optima = [self._optimise(start, quantity) for start in starts]
        return min(optima, key=lambda force: self.value(force, quantity))

    def value(self, force: np.ndarray, quantity: str) -> float:
        """Return the criterion for a force, scaled to the energy of the test: the mean log variance or volume."""
        scaled = self.test.scale(force)
        columns, values = criterion_columns(quantity, 5), []
        for oscillator, free in zip(self.likely.oscillators, self.free, strict=True):
            rows = derivatives(oscillator, self.test.times, scaled[:, None])[:, :, 0].T
            values.append(_criterion(np.concatenate([rows, free], axis=1), columns)[0])
        return float(np.mean(values))

    def _phased(self, shares: np.ndarray, quantity: str) -> np.ndarray:
        """Return a multisine with given powers and the best of :data:`DRAWS` random sets of phases."""
        rng, sizes = np.random.default_rng(0), np.sqrt(shares)
        phases = rng.uniform(0.0, 2.0 * np.pi, (DRAWS, sizes.size))
        forces = [self.basis @ np.concatenate([sizes * np.cos(p), sizes * np.sin(p)]) for p in phases]
        return min(forces, key=lambda force: self.value(force, quantity))

    def _optimise(self, force: np.ndarray, quantity: str) -> np.ndarray:
        """Optimise the lines locally, starting from a force."""
        from scipy.optimize import minimize  # slow to import

        start = np.linalg.lstsq(self.basis, force, rcond=None)[0]
        columns = criterion_columns(quantity, 5)
        optimum = minimize(
            self._with_gradient, start / np.linalg.norm(start), (columns,), "L-BFGS-B", True,
            options={"maxiter": ITERATIONS, "maxcor": 20},
        )  # fmt: skip
        return np.asarray(self.basis @ optimum.x)

    def _with_gradient(self, lines: np.ndarray, columns: np.ndarray) -> tuple[float, np.ndarray]:
        """Return the criterion, independent of the scale of the force, and its gradient by the coefficients
        ``lines``."""
        value, gradient = 0.0, np.zeros_like(lines)
        for motions, free in zip(self.motions, self.free, strict=True):
            term, slope = _criterion(np.concatenate([(motions @ lines).T, free], axis=1), columns)
            value += term / len(self.motions)
            gradient += np.einsum("np,pnq->q", slope[:, :3], motions) / len(self.motions)
        force = self.basis @ lines
        energy, size = self.test.energy_of(force), columns.shape[1]
        padded = np.concatenate([[0.0], force, [0.0]])
        slope = padded[:-2] + 4.0 * force + padded[2:]
        slope[[0, -1]] -= 2.0 * force[[0, -1]]
        gradient += size * self.basis.T @ slope * (self.test.interval / 3.0) / energy
        return value + size * float(np.log(energy / self.test.energy)), gradient


def _criterion(rows: np.ndarray, columns: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the log squared volume of the confidence region, and its gradient by the Jacobian.

    Args:
        rows: Jacobian of the motion (n, p), for noise of unit variance.
        columns: The quantities of the criterion, see :func:`criterion_columns`.
    """
    scale = np.linalg.norm(rows, axis=0)  # equal column norms make the inverse as accurate as possible
    scaled, weights = rows / scale, columns / scale[:, None]
    inverse = np.linalg.inv(scaled.T @ scaled)
    wanted = inverse @ weights
    block = weights.T @ wanted
    slope = -2.0 * scaled @ wanted @ np.linalg.solve(block, wanted.T) / scale
    return float(np.linalg.slogdet(block)[1]), slope
