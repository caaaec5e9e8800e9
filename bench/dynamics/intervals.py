"""Intervals of a record in which every force is a single polynomial, and integration steps within them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.contract.problem import Force, Record


def merged_grid(times: np.ndarray, forces: Sequence[Force]) -> np.ndarray:
    """Merge zero, times and sample times of forces up to the last time into an increasing grid, shape (n,)."""
    return np.unique(np.concatenate([[0.0], times, *[f.times[f.times <= times[-1]] for f in forces]]))


def sample_times(record: Record) -> tuple[np.ndarray, list[slice | np.ndarray]]:
    """Return the increasing sample times of all channels of a record, and the indices of each channel in them."""
    first = record.channels[0].times
    if all(np.array_equal(channel.times, first) for channel in record.channels):
        return first, [slice(None)] * len(record.channels)
    times = np.unique(np.concatenate([channel.times for channel in record.channels]))
    return times, [np.searchsorted(times, channel.times) for channel in record.channels]


def interval_polynomials(forces: Sequence[Force], grid: np.ndarray, n_dof: int) -> np.ndarray:
    """Compute the polynomial coefficients of the force on each DOF in each interval of a grid.

    Args:
        forces: Known forces.
        grid: Increasing times (s), including the sample times of the forces, shape (n_intervals + 1,).
        n_dof: Number of degrees of freedom.

    Returns:
        Coefficients (N) in increasing powers of the elapsed fraction of the interval, shape (degree + 1, n_intervals,
        n_dof). They are computed from values inside the interval, since a force may jump at its ends.
    """
    degree = max((force.degree for force in forces), default=0)
    nodes = (np.arange(degree + 1) + 0.5) / (degree + 1)
    times = grid[:-1] + nodes[:, None] * np.diff(grid)
    total = np.zeros((degree + 1, grid.size - 1, n_dof))
    for force in forces:
        total[..., force.dof] += np.linalg.solve(np.vander(nodes, increasing=True), force(times))
    return total


def step_counts(grid: np.ndarray, longest: float | np.floating[Any]) -> np.ndarray:
    """Return the number of equal steps in each interval of a grid.

    Args:
        grid: Increasing times (s), shape (n_grid,).
        longest: Largest length of a step (s).

    Returns:
        Integers of at least 1, shape (n_grid - 1,).
    """
    return np.maximum(1, np.ceil(np.diff(grid) / longest)).astype(int)


@dataclass(frozen=True, eq=False)
class Steps:
    """Integration steps from the first to the last point of a grid.

    Attributes:
        lengths: Lengths (s), shape (J,).
        forces: Forces (N) at the beginning, middle and end of each step, shape (J, 3, n_dof).
        reached: Number of steps up to each point of the grid, shape (n_grid,).
    """

    lengths: np.ndarray
    forces: np.ndarray
    reached: np.ndarray

    @staticmethod
    def over(grid: np.ndarray, counts: np.ndarray, forces: Sequence[Force], n_dof: int) -> Steps:
        """Divide the intervals of a grid into equal steps.

        Args:
            grid: Increasing times (s), including the sample times of the forces, shape (n_grid,).
            counts: Number of steps in each interval, shape (n_grid - 1,).
            forces: Known forces.
            n_dof: Number of degrees of freedom.

        Returns:
            The steps.
        """
        interval, reached = np.repeat(np.arange(counts.size), counts), np.concatenate([[0], np.cumsum(counts)])
        within = (np.arange(interval.size) - reached[interval])[:, None] + np.array([0.0, 0.5, 1.0])
        part = (within / counts[interval, None])[..., None]
        total = np.zeros((*within.shape, n_dof))
        for coefficients in interval_polynomials(forces, grid, n_dof)[::-1]:
            total = coefficients[interval, None] + total * part
        return Steps((np.diff(grid) / counts)[interval], total, reached)
