"""Collocation points: fixed, random at each step, or concentrated where residuals are large."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from bench import Problem
from methods.network.ansatz import Ansatz
from methods.pinn.block import Block, exact_start
from methods.pinn.residuals import Residuals

CANDIDATES = 10
"""Number of candidates of residual-based adaption over that of selected points."""


class Sampling:
    """Fixed, evenly spaced points as in the paper; subclasses draw new points after ``every`` gradients."""

    every = 0

    def __init__(
        self, problem: Problem, make_ansatz: Callable[[int, Block], Ansatz], omega: float, rng: np.random.Generator
    ) -> None:
        self.problem, self.make_ansatz, self.omega, self.rng = problem, make_ansatz, omega, rng

    def points(self, residuals: Residuals, z: Tensor) -> list[np.ndarray]:
        """Return new points (collocation,) of each record, including its ends, for the response at z (n_z,)."""
        raise NotImplementedError

    def moved(self, residuals: Residuals, z: Tensor) -> Residuals:
        """Return the residual vector at new points."""
        return self.placed(residuals, self.points(residuals, z))

    def placed(self, residuals: Residuals, points: Sequence[np.ndarray]) -> Residuals:
        """Return the residual vector with the equation of motion at given points."""
        other = copy.copy(residuals)
        other.blocks = [self._placed(k, block, points[k]) for k, block in enumerate(residuals.blocks)]
        other.ansatzes = [self.make_ansatz(k, block) for k, block in enumerate(other.blocks)]
        return other

    def _placed(self, k: int, block: Block, times: np.ndarray) -> Block:
        record, device = self.problem.records[k], block.values.device
        moved = copy.copy(block)
        moved.times = np.concatenate([times, block.times[0, block.collocation :]])[None]
        force = record.force(times, self.problem.system.n_dof)
        moved.force = [torch.as_tensor(np.array(part)[None], device=device) for part in force]
        if block.lift is not None and record.initial_state is not None:
            known = np.stack([record.initial_state.displacement, record.initial_state.velocity])[None]
            lift, shape = exact_start(moved.times, known, np.array([self.omega]))
            moved.lift, moved.shape = torch.as_tensor(lift, device=device), torch.as_tensor(shape, device=device)
        return moved


class Random(Sampling):
    """Uniformly random points, drawn at each step; the ends of the record are kept."""

    every = 1

    def points(self, residuals: Residuals, z: Tensor) -> list[np.ndarray]:
        points = []
        for block in residuals.blocks:
            inner = np.sort(self.rng.uniform(0.0, block.duration[0], block.collocation - 2))
            points.append(np.array([0.0, *inner, block.duration[0]]))
        return points


class Adaptive(Sampling):
    """Points drawn every hundred steps with a probability that increases with the residual.

    Residual-based adaptive distribution with k = c = 1: C. Wu et al., Comput. Methods Appl. Mech. Eng. 403:115671,
    2023.
    """

    every = 100

    def points(self, residuals: Residuals, z: Tensor) -> list[np.ndarray]:
        fine = [np.linspace(0.0, block.duration[0], CANDIDATES * block.collocation) for block in residuals.blocks]
        sizes = [np.zeros(times.size) for times in fine]
        for first in range(CANDIDATES):  # the vector has rows for ``collocation`` points
            placed = self.placed(residuals, [times[first::CANDIDATES] for times in fine])
            for size, part in zip(sizes, _equation_sizes(placed, z), strict=True):
                size[first::CANDIDATES] = part
        points = []
        for block, times, size in zip(residuals.blocks, fine, sizes, strict=True):
            inner = size[1:-1] / size[1:-1].mean() + 1.0
            chosen = self.rng.choice(inner.size, block.collocation - 2, replace=False, p=inner / inner.sum())
            points.append(np.concatenate([times[:1], times[1:-1][np.sort(chosen)], times[-1:]]))
        return points


def _equation_sizes(residuals: Residuals, z: Tensor) -> list[np.ndarray]:
    """Return the absolute residual of the equation at each point of each record, summed over the paths."""
    ones = torch.ones(1, residuals.n_rows, dtype=torch.float64, device=residuals.device)
    rows = np.abs(residuals.evaluate(z[None], ones).rows[0].cpu().numpy())
    sizes, first = [], 0
    for block in residuals.blocks:
        physics = rows[first : first + block.n_rows][block.slices["physics"]]
        sizes.append(physics.reshape(-1, block.collocation).sum(0))
        first += block.n_rows
    return sizes


SAMPLINGS: Mapping[str, type[Sampling]] = {"uniform": Sampling, "random": Random, "adaptive": Adaptive}
