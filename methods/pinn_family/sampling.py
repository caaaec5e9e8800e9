"""Where the equation of motion is asked for: fixed, drawn anew at each step, or where it is violated most."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from bench import Problem, Record
from methods.network.ansatz import Ansatz
from methods.pinn.block import Block, exact_start
from methods.pinn.residuals import Residuals

CANDIDATES = 10
"""Points among which residual-based adaption chooses, over those it keeps."""


class TrainingResiduals(Residuals):
    """The residual vector of one problem, :class:`Residuals` with two liberties more.

    ``shift`` (1, n_rows) is added to the rows before they are divided by their deviations: the multipliers of an
    augmented Lagrangian. :meth:`placed` asks the equation of motion at points of one's own.
    """

    problem: Problem
    make_ansatz: Callable[[int, Block], Ansatz]
    shift: Tensor | None = None

    @classmethod
    def of(
        cls, residuals: Residuals, problem: Problem, make_ansatz: Callable[[int, Block], Ansatz]
    ) -> TrainingResiduals:
        """Return the same vector as ``residuals``, of one fit."""
        copy = cls.__new__(cls)
        vars(copy).update(vars(residuals))
        copy.problem, copy.make_ansatz = problem, make_ansatz
        return copy

    def placed(self, points: Sequence[np.ndarray], omega: float) -> TrainingResiduals:
        """Return the same with collocation points (n_points,) of each record; first and last are its ends."""
        copy = TrainingResiduals.of(self, self.problem, self.make_ansatz)
        records = zip(self.blocks, self.problem.records, points, strict=True)
        copy.blocks = [_placed(block, record, times, self.system.n_dof, omega) for block, record, times in records]
        copy.ansatzes = [self.make_ansatz(k, block) for k, block in enumerate(copy.blocks)]
        return copy

    def rows(self, outputs: Sequence[Tensor], logs: Tensor, offsets: Tensor) -> Tensor:
        rows = super().rows(outputs, logs, offsets)
        return rows if self.shift is None else rows + self.shift


def _placed(block: Block, record: Record, times: np.ndarray, n_dof: int, omega: float) -> Block:
    """Return a block whose collocation points are ``times``."""
    device = block.values.device
    moved = block.take(torch.zeros(1, dtype=torch.long, device=device))
    moved.times = np.concatenate([times, block.times[0, block.collocation :]])[None]
    moved.force = [torch.as_tensor(np.array(part)[None], device=device) for part in record.force(times, n_dof)]
    if block.lift is not None:
        start = record.initial_state
        assert start is not None
        known = np.stack([start.displacement, start.velocity])[None]
        lift, shape = exact_start(moved.times, known, np.array([omega]))
        moved.lift, moved.shape = torch.as_tensor(lift, device=device), torch.as_tensor(shape, device=device)
    return moved


class Sampling(ABC):
    """Moves collocation points every so many gradients; 0: never."""

    every = 0

    def __init__(self, omega: float, rng: np.random.Generator) -> None:
        self.omega, self.rng = omega, rng

    @abstractmethod
    def moved(self, residuals: TrainingResiduals, z: Tensor) -> TrainingResiduals:
        """Return the residual vector at new points, for the response at z (n_z,)."""


class Uniform(Sampling):
    """Evenly spaced and fixed, as in the paper."""

    def moved(self, residuals: TrainingResiduals, z: Tensor) -> TrainingResiduals:
        return residuals


class Random(Sampling):
    """Uniformly random, drawn anew at each step; the ends of the record stay."""

    every = 1

    def moved(self, residuals: TrainingResiduals, z: Tensor) -> TrainingResiduals:
        points = []
        for block in residuals.blocks:
            duration = float(block.duration[0])
            inner = np.sort(self.rng.uniform(0.0, duration, block.collocation - 2))
            points.append(np.concatenate([[0.0], inner, [duration]]))
        return residuals.placed(points, self.omega)


class Adaptive(Sampling):
    """Drawn with a probability that grows with the residual, every hundred steps.

    Residual-based adaptive distribution with k = c = 1: C. Wu et al., Comput. Methods Appl. Mech. Eng. 403:115671,
    2023.
    """

    every = 100

    def moved(self, residuals: TrainingResiduals, z: Tensor) -> TrainingResiduals:
        fine = [np.linspace(0.0, float(b.duration[0]), CANDIDATES * b.collocation) for b in residuals.blocks]
        sizes = [np.zeros(times.size) for times in fine]
        for first in range(CANDIDATES):  # as many points at a time as the vector has rows for
            placed = residuals.placed([times[first::CANDIDATES] for times in fine], self.omega)
            for size, part in zip(sizes, _equation_sizes(placed, z), strict=True):
                size[first::CANDIDATES] = part
        points = []
        for block, times, size in zip(residuals.blocks, fine, sizes, strict=True):
            inner = size[1:-1] / size[1:-1].mean() + 1.0
            chosen = self.rng.choice(inner.size, block.collocation - 2, replace=False, p=inner / inner.sum())
            points.append(np.concatenate([times[:1], times[1:-1][np.sort(chosen)], times[-1:]]))
        return residuals.placed(points, self.omega)


def _equation_sizes(residuals: TrainingResiduals, z: Tensor) -> list[np.ndarray]:
    """Return the absolute residual of the equation at each point, summed over the paths, record by record."""
    ones = torch.ones(1, residuals.n_rows, dtype=torch.float64, device=residuals.device)
    rows = np.asarray(residuals.evaluate(z[None], ones).rows[0].cpu())
    sizes, first = [], 0
    for block in residuals.blocks:
        physics = rows[first : first + block.n_rows][block.slices["physics"]]
        sizes.append(np.abs(physics.reshape(-1, block.collocation)).sum(0))
        first += block.n_rows
    return sizes


SAMPLINGS: Mapping[str, type[Sampling]] = {"uniform": Uniform, "random": Random, "adaptive": Adaptive}
