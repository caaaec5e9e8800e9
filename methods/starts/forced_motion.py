"""What a known force alone would do: functions that take its jumps and its roughness out of the fitted response.

Where a force jumps, so does the acceleration, and neither a smooth network nor a spline follows; a rough force makes
the response as rough, two integrations down. The response is therefore the trainable function *plus* a multiple of
what an oscillator of unit mass does under the force of each forced DOF, ``q'' + 2 d q' + (w² + d²) q = f`` from rest,
with ``w`` and ``d`` from the data's dominant damped wave. That has the jumps of f in its second derivative exactly;
the equation of motion sets its multiple to 1 over the mass, and what is left to learn is two orders smoother than
before. The oscillator need not be the true one. In plain numpy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench import Force

NODES = 5
"""Gauss-Legendre nodes a step; a step turns an oscillator by at most ``RADIANS``."""
RADIANS = 0.5


def forced_dofs(forces: Sequence[Force]) -> tuple[int, ...]:
    """The degrees of freedom that a force acts on."""
    return tuple(sorted({f.dof for f in forces if np.any(f.values)}))


def force_by_dof(forces: Sequence[Force], times: np.ndarray) -> np.ndarray:
    """The force on each forced degree of freedom at times of any shape, (n_forced, *shape)."""
    return np.stack([np.sum([f(times) for f in forces if f.dof == dof], axis=0) for dof in forced_dofs(forces)])


def forced_motion(forces: Sequence[Force], rates: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Displacement, velocity and acceleration of those oscillators at any times >= 0, (*shape, 3, n_times, n_forced).

    ``rates`` of any shape are their ``s = -d + i w``. ``z' = s z + f`` carries both: ``q = Im z / w``. Between samples
    of a force it is integrated by Gauss-Legendre quadrature of ``exp(s (t - τ)) f(τ)``.
    """
    s, end = rates.reshape(-1, 1), float(np.max(times))
    parts = max(2, int(np.ceil(float(np.max(np.abs(s))) * end / RADIANS)) + 1)
    knots = [f.times[(f.times > 0) & (f.times < end)] for f in forces]
    grid = np.unique(np.concatenate([np.linspace(0.0, end, parts), *knots, times]))
    h = np.diff(grid)
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    past = 0.5 * h[:, None] * (nodes + 1.0)
    inside = force_by_dof(forces, grid[:-1, None] + past) * (0.5 * h[:, None] * weights)
    z = np.zeros((grid.size, rates.size, len(inside)), complex)
    for k in range(h.size):
        z[k + 1] = np.exp(s * h[k]) * z[k] + np.exp(s * (h[k] - past[k])) @ inside[:, k].T
    z = np.moveaxis(z[np.searchsorted(grid, times)], 0, 1)
    s = s[:, :, None]
    q = np.stack([(z * s**order).imag / s.imag for order in range(3)], axis=1)
    q[:, 2] += force_by_dof(forces, times).T
    return q.reshape(*rates.shape, *q.shape[1:])


@dataclass(frozen=True, eq=False)
class ForcedMotion:
    """Those functions for one oscillator, each divided by its ``sizes`` (n_forced,), so that all are of unit size."""

    forces: tuple[Force, ...]
    rate: complex
    sizes: np.ndarray

    @staticmethod
    def of(forces: Sequence[Force], rate: complex, times: np.ndarray) -> ForcedMotion:
        """With the root mean square displacement at ``times`` as their sizes."""
        q = forced_motion(forces, np.array(rate), times)[0]
        size = np.sqrt(np.mean(q**2, axis=0))
        return ForcedMotion(tuple(forces), rate, np.where(size > 0, size, 1.0))

    def streams(self, times: np.ndarray) -> np.ndarray:
        """Their values and first and second derivatives, (3, n_times, n_forced)."""
        return forced_motion(self.forces, np.array(self.rate), times) / self.sizes

    def __call__(self, times: np.ndarray) -> np.ndarray:
        """Their values, (n_forced, n_times)."""
        return np.asarray(self.streams(np.asarray(times, float))[0].T)
