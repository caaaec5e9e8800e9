"""Motion of an auxiliary oscillator under the known force, which makes the remaining response smooth.

Where a force jumps, so does the acceleration, and neither a smooth network nor a spline can represent that. The
response is therefore modelled as the trainable function *plus* multiples of the motion of an oscillator of unit mass
under the force of each forced DOF, ``q'' + 2 d q' + (w² + d²) q = f`` from rest, and of its derivatives by ``d`` and
``w``, which are those of the dominant damped wave in the data. The second derivative of q has exactly the jumps of f;
the equation of motion sets its multiple to 1 over the mass, and the remaining function is two orders smoother. The
oscillator need not be the true one: the derivatives represent its error to first order. Without them a spline that
obeys the equation of motion after a blow is biased, and a network's intervals are too narrow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench import SDOF, Force, simulate

RATE_STEP = 1e-3
"""Step of the differences that give the derivatives by d and w, over the size of the rate."""


def forced_dofs(forces: Sequence[Force]) -> tuple[int, ...]:
    """Return the degrees of freedom that a force acts on."""
    return tuple(sorted({f.dof for f in forces if np.any(f.values)}))


def force_by_dof(forces: Sequence[Force], times: np.ndarray) -> np.ndarray:
    """Evaluate the force on each forced degree of freedom at times of any shape, (n_forced, *shape)."""
    return np.stack([np.sum([f(times) for f in forces if f.dof == dof], axis=0) for dof in forced_dofs(forces)])


def forced_motion(forces: Sequence[Force], rates: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Simulate displacement, velocity and acceleration of auxiliary oscillators, (*shape, 3, n_times, n_forced).

    ``rates`` of any shape are their ``s = -d + i w``; the times are >= 0, in any order.
    """
    grid, places = np.unique(times, return_inverse=True)
    p = {"m": np.ones(rates.shape), "c": -2.0 * rates.real, "k": np.abs(rates) ** 2}
    rest = np.zeros((1, *rates.shape))
    by_dof = []
    for dof, push in zip(forced_dofs(forces), force_by_dof(forces, times), strict=True):
        acting = [replace(force, dof=0) for force in forces if force.dof == dof]
        motion = simulate(SDOF(), p, (rest, rest), grid, acting)
        x, v = (part[0][..., places] for part in (motion.displacement, motion.velocity))
        by_dof.append(np.stack([x, v, push - p["c"][..., None] * v - p["k"][..., None] * x], axis=-2))
    return np.stack(by_dof, axis=-1)


def motion_and_derivatives(forces: Sequence[Force], rate: complex, times: np.ndarray) -> np.ndarray:
    """Simulate the motion of auxiliary oscillators and its derivatives by d and w, (3, n_times, 3 n_forced).

    The derivatives are central differences, times the size of the rate.
    """
    steps = RATE_STEP * abs(rate) * np.array([0.0, -1.0, 1.0, 1j, -1j])
    motion, more_d, less_d, more_w, less_w = forced_motion(forces, rate + steps, times)
    differences = np.concatenate([more_d - less_d, more_w - less_w], axis=-1)
    return np.concatenate([motion, differences / (2.0 * RATE_STEP)], axis=-1)


@dataclass(frozen=True, eq=False)
class ForcedMotion:
    """Motion of one auxiliary oscillator per forced DOF and its derivatives, divided by ``sizes`` (3 n_forced,)."""

    forces: tuple[Force, ...]
    rate: complex
    sizes: np.ndarray

    @staticmethod
    def of(forces: Sequence[Force], rate: complex, times: np.ndarray) -> ForcedMotion:
        """Take the root mean square displacements at ``times`` as sizes."""
        size = np.sqrt(np.mean(motion_and_derivatives(forces, rate, times)[0] ** 2, axis=0))
        return ForcedMotion(tuple(forces), rate, np.where(size > 0, size, 1.0))

    def streams(self, times: np.ndarray) -> np.ndarray:
        """Return the functions with their first and second time derivatives, (3, n_times, 3 n_forced)."""
        return motion_and_derivatives(self.forces, self.rate, times) / self.sizes

    def __call__(self, times: np.ndarray) -> np.ndarray:
        """Return the functions, (3 n_forced, n_times)."""
        return np.asarray(self.streams(np.asarray(times, float))[0].T)
