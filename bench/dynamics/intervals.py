"""The intervals of a record within which every force is one polynomial, and the integration steps within them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.contract.problem import Force, Record


def merged_grid(times: np.ndarray, forces: Sequence[Force]) -> np.ndarray:
    """Return zero, the times, and between them those at which a force has a sample; increasing, shape (n,)."""
    return np.unique(np.concatenate([[0.0], times, *[f.times[f.times <= times[-1]] for f in forces]]))


def sample_times(record: Record) -> tuple[np.ndarray, list[slice | np.ndarray]]:
    """Return the times at which any sensor of a record is read, increasing, and where among them each channel's are."""
    first = record.channels[0].times
    if all(np.array_equal(channel.times, first) for channel in record.channels):
        return first, [slice(None)] * len(record.channels)
    times = np.unique(np.concatenate([channel.times for channel in record.channels]))
    return times, [np.searchsorted(times, channel.times) for channel in record.channels]


def interval_polynomials(forces: Sequence[Force], grid: np.ndarray, n_dof: int) -> np.ndarray:
    """Compute the coefficients of the force on each DOF over each interval of a grid that holds the forces' samples.

    Shape (degree + 1, n_intervals, n_dof), in powers of the part of the interval that has passed; from values inside
    the interval, since the force may jump at its ends.
    """
    degree = max((force.degree for force in forces), default=0)
    nodes = (np.arange(degree + 1) + 0.5) / (degree + 1)
    times = grid[:-1] + nodes[:, None] * np.diff(grid)
    total = np.zeros((degree + 1, grid.size - 1, n_dof))
    for force in forces:
        total[..., force.dof] += np.linalg.solve(np.vander(nodes, increasing=True), force(times))
    return total


def step_counts(grid: np.ndarray, longest: float | np.floating[Any]) -> np.ndarray:
    """Count the steps within each interval of a grid that are no longer than ``longest``, shape (n_grid - 1,)."""
    return np.maximum(1, np.ceil(np.diff(grid) / longest)).astype(int)


@dataclass(frozen=True, eq=False)
class Steps:
    """The steps from the first point of a grid to the last.

    ``lengths`` (J,) in s; ``forces`` (J, 3, n_dof): the forces (N) at the start, middle and end of each step;
    ``reached`` (n_grid,): how many steps lead to each point of the grid.
    """

    lengths: np.ndarray
    forces: np.ndarray
    reached: np.ndarray

    @staticmethod
    def over(grid: np.ndarray, counts: np.ndarray, forces: Sequence[Force], n_dof: int) -> Steps:
        """Make ``counts`` (n_grid - 1,) steps in each interval of a grid that holds the samples of the forces."""
        interval, reached = np.repeat(np.arange(counts.size), counts), np.concatenate([[0], np.cumsum(counts)])
        within = (np.arange(interval.size) - reached[interval])[:, None] + np.array([0.0, 0.5, 1.0])
        part = (within / counts[interval, None])[..., None]
        total = np.zeros((*within.shape, n_dof))
        for coefficients in interval_polynomials(forces, grid, n_dof)[::-1]:
            total = coefficients[interval, None] + total * part
        return Steps((np.diff(grid) / counts)[interval], total, reached)
