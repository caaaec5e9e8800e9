"""The intervals of a record within which every force is one polynomial: their ends, and the coefficients."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench.contract.problem import Force


def merged_grid(times: np.ndarray, forces: Sequence[Force]) -> np.ndarray:
    """Zero, the times, and between them those at which a force has a sample; increasing, shape (n,)."""
    return np.unique(np.concatenate([[0.0], times, *[f.times[f.times <= times[-1]] for f in forces]]))


def interval_polynomials(forces: Sequence[Force], grid: np.ndarray, n_dof: int) -> np.ndarray:
    """Coefficients of the force on each DOF over each interval of a grid that holds the forces' samples.

    Shape (degree + 1, n_intervals, n_dof), in powers of the part of the interval that has passed; from values inside
    the interval, since the force may jump at its ends.
    """
    degree = max((force.degree for force in forces), default=0)
    nodes = (np.arange(degree + 1) + 0.5) / (degree + 1)
    at = grid[:-1] + nodes[:, None] * np.diff(grid)
    total = np.zeros((degree + 1, grid.size - 1, n_dof))
    for force in forces:
        total[..., force.dof] += np.linalg.solve(np.vander(nodes, increasing=True), force(at))
    return total
