"""Fisher information of a test with a measured force, with unknown initial state.

The force is sampled together with the displacement and is linear between samples, so that the motion is a sum of
responses to hat functions. A hat is a second difference of ramps, and the ramp response has a closed form: the solution
of ``x'' + (c/m) x' + (k/m) x = t`` from rest is ``x = (t - h - (c/m) (1 - g) / (k/m)) / (k/m)``, where ``g`` and ``h``
are the free responses to a unit displacement and a unit velocity. Derivatives are computed by complex steps, as for a
free decay.

Units: displacement over the standard deviation of the noise; force over mass and over that standard deviation.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bench.planning.free_decay import QUANTITIES, STEP, Oscillator, errors, responses

FORCED_QUANTITIES = {**QUANTITIES, "mass": (0.0, 0.0, -1.0)}
"""Exponents of k/m, c/m and 1/m in each quantity: those of a free decay, and the mass."""


@dataclass(frozen=True)
class ForcedTest:
    """A test from rest, with an initial state that is unknown to the method.

    ``samples`` of force and displacement over ``duration`` (s), both ends included; ``energy``: integral of the squared
    force, in the units of this module.
    """

    samples: int
    duration: float
    energy: float

    @cached_property
    def times(self) -> np.ndarray:
        """Times of the samples (s), (samples,)."""
        return np.linspace(0.0, self.duration, self.samples)

    @property
    def interval(self) -> float:
        """Sampling interval (s)."""
        return self.duration / (self.samples - 1)

    def energy_of(self, force: np.ndarray) -> float:
        """Return the integral of the square of a force (n,) that is linear between samples."""
        return float(self.interval * np.sum(force[:-1] ** 2 + force[:-1] * force[1:] + force[1:] ** 2) / 3.0)

    def scale(self, force: np.ndarray) -> np.ndarray:
        """Scale a force (n,) to the energy of the test."""
        return np.asarray(force * np.sqrt(self.energy / self.energy_of(force)))


def derivatives(oscillator: Oscillator, times: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Return the derivatives of the motion by log k/m, log c/m and log 1/m, (3, n, q), for several forces (n, q).

    The derivative by log 1/m is the displacement, which is proportional to 1/m.
    """
    stiffness, damping = oscillator.omega**2, 2.0 * oscillator.damping_ratio * oscillator.omega
    perturbed = [
        np.imag(_hat_responses(times, stiffness * (1.0 + 1j * a), damping * (1.0 + 1j * b))) / STEP
        for a, b in ((STEP, 0.0), (0.0, STEP))
    ]
    hats = [*perturbed, np.real(_hat_responses(times, stiffness, damping))]
    return np.stack([_sum_of_hats(first, others, forces) for first, others in hats])


def _hat_responses(times: np.ndarray, stiffness: complex, damping: complex) -> np.ndarray:
    """Return the responses (2, n) to the falling half of a hat at the first sample, and to a full hat at it."""
    step = float(times[1])
    extended = np.append(times, times[-1] + step)
    even, odd = responses(extended, stiffness, damping)
    constant = (1.0 - even) / stiffness
    ramp = (extended - odd - damping * constant) / stiffness
    before = np.concatenate([[0.0], ramp[:-2]])
    first = constant[:-1] - (ramp[:-1] - before) / step
    return np.stack([first, (ramp[1:] - 2.0 * ramp[:-1] + before) / step])


def _sum_of_hats(first: np.ndarray, others: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Return the motion (n, q) under forces (n, q) from the hat responses."""
    from scipy.linalg import toeplitz  # slow to import

    matrix = toeplitz(others, np.zeros_like(others))
    matrix[:, 0] = first
    return np.asarray(matrix @ forces)


def free_motions(oscillator: Oscillator, times: np.ndarray) -> np.ndarray:
    """Return the free responses (n, 2) to a unit displacement and a unit velocity."""
    stiffness, damping = oscillator.omega**2, 2.0 * oscillator.damping_ratio * oscillator.omega
    return np.real(np.stack(responses(times, stiffness, damping), axis=1))


def displacement(oscillator: Oscillator, test: ForcedTest, force: np.ndarray) -> np.ndarray:
    """Return the motion (n,) from rest under a force (n,)."""
    return np.asarray(derivatives(oscillator, test.times, force[:, None])[2, :, 0])


def information(oscillator: Oscillator, test: ForcedTest, force: np.ndarray) -> np.ndarray:
    """Return the Fisher information (5, 5) about log k/m, log c/m, log 1/m, x0 and v0, for noise of unit variance."""
    by_parameters = derivatives(oscillator, test.times, force[:, None])[:, :, 0].T
    jacobian = np.concatenate([by_parameters, free_motions(oscillator, test.times)], axis=1)
    return np.asarray(jacobian.T @ jacobian)


def forced_errors(oscillator: Oscillator, test: ForcedTest, force: np.ndarray) -> dict[str, float]:
    """Return the bound on the standard deviation of the logarithm of each of :data:`FORCED_QUANTITIES`."""
    return errors(information(oscillator, test, force), FORCED_QUANTITIES)
