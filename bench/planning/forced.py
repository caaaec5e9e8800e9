"""What a test under a measured force tells of an oscillator: information of the displacement, start unknown.

The force is sampled with the displacement and runs linearly from one sample to the next, so that the motion is a sum of
responses to hats. A hat is a second difference of the ramp ``r``, and the response to a ramp is closed: ``x'' + (c/m)
x' + (k/m) x = r(t)`` integrated once gives ``x = (t - h - (c/m) (1 - g) / (k/m)) / (k/m)``, with ``g`` and ``h`` the
motions from a unit displacement and a unit velocity. The transient from rest is in it. Derivatives are complex steps,
as for a free decay.

Units: displacement over the noise's standard deviation; force over mass and over that standard deviation.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bench.planning.free_decay import QUANTITIES, STEP, Oscillator, errors, responses

FORCED_QUANTITIES = {**QUANTITIES, "mass": (0.0, 0.0, -1.0)}
"""Exponents of k/m, c/m and 1/m in each: what a free decay tells, and the mass."""


@dataclass(frozen=True)
class ForcedTest:
    """``samples`` of force and displacement over ``duration`` (s), both ends included, from rest, which is not told.

    ``energy``: the integral of the squared force, in the units of this module.
    """

    samples: int
    duration: float
    energy: float

    @cached_property
    def times(self) -> np.ndarray:
        """Of the samples (s)."""
        return np.linspace(0.0, self.duration, self.samples)

    @property
    def interval(self) -> float:
        """Between samples, s."""
        return self.duration / (self.samples - 1)

    def energy_of(self, force: np.ndarray) -> float:
        """The integral of the square of a force (n,), which is linear between samples."""
        return float(self.interval * np.sum(force[:-1] ** 2 + force[:-1] * force[1:] + force[1:] ** 2) / 3.0)

    def scaled(self, force: np.ndarray) -> np.ndarray:
        """A force of the same shape with the energy of the test."""
        return np.asarray(force * np.sqrt(self.energy / self.energy_of(force)))


def derivatives(oscillator: Oscillator, times: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Of the motion under each of some forces (n, q), by log k/m, log c/m and log 1/m: (3, n, q).

    The last is the displacement itself: it is proportional to 1/m.
    """
    stiffness, damping = oscillator.omega**2, 2.0 * oscillator.damping_ratio * oscillator.omega
    moved = [
        np.imag(_hat_responses(times, stiffness * (1.0 + 1j * a), damping * (1.0 + 1j * b))) / STEP
        for a, b in ((STEP, 0.0), (0.0, STEP))
    ]
    hats = [*moved, np.real(_hat_responses(times, stiffness, damping))]
    return np.stack([_sum_of_hats(first, others, forces) for first, others in hats])


def _hat_responses(times: np.ndarray, stiffness: complex, damping: complex) -> np.ndarray:
    """(2, n): the response to half a hat that falls from the first sample on, and to a hat about it."""
    step = float(times[1])
    longer = np.append(times, times[-1] + step)
    even, odd = responses(longer, stiffness, damping)
    constant = (1.0 - even) / stiffness
    ramp = (longer - odd - damping * constant) / stiffness
    before = np.concatenate([[0.0], ramp[:-2]])
    first = constant[:-1] - (ramp[:-1] - before) / step
    return np.stack([first, (ramp[1:] - 2.0 * ramp[:-1] + before) / step])


def _sum_of_hats(first: np.ndarray, others: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """The motion (n, q) under forces (n, q), from the responses to their hats."""
    from scipy.linalg import toeplitz  # slow to import

    late = np.zeros_like(others)
    matrix = toeplitz(others, late)
    matrix[:, 0] = first
    return np.asarray(matrix @ forces)


def free_motions(oscillator: Oscillator, times: np.ndarray) -> np.ndarray:
    """The motions (n, 2) from a unit displacement and a unit velocity: derivatives by the start."""
    stiffness, damping = oscillator.omega**2, 2.0 * oscillator.damping_ratio * oscillator.omega
    return np.real(np.stack(responses(times, stiffness, damping), axis=1))


def displacement(oscillator: Oscillator, test: ForcedTest, force: np.ndarray) -> np.ndarray:
    """The motion (n,) under a force (n,), from rest."""
    return np.asarray(derivatives(oscillator, test.times, force[:, None])[2, :, 0])


def information(oscillator: Oscillator, test: ForcedTest, force: np.ndarray) -> np.ndarray:
    """The Fisher information (5, 5) of samples of unit noise, about log k/m, log c/m, log 1/m, x0 and v0."""
    by_force = derivatives(oscillator, test.times, force[:, None])[:, :, 0].T
    every = np.concatenate([by_force, free_motions(oscillator, test.times)], axis=1)
    return np.asarray(every.T @ every)


def forced_errors(oscillator: Oscillator, test: ForcedTest, force: np.ndarray) -> dict[str, float]:
    """The bound on the standard deviation of the logarithm of each of :data:`FORCED_QUANTITIES`."""
    return errors(information(oscillator, test, force), FORCED_QUANTITIES)
