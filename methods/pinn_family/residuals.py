"""The engine's residual vector for training: collocation points that may move, and a shift of the rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor

from bench import Problem, Record
from methods.network.ansatz import Ansatz
from methods.pinn.block import Block, exact_start
from methods.pinn.residuals import Residuals


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
        """The same vector as ``residuals``, of one fit."""
        own = cls.__new__(cls)
        vars(own).update(vars(residuals))
        own.problem, own.make_ansatz = problem, make_ansatz
        return own

    def placed(self, points: Sequence[np.ndarray], omega: float) -> TrainingResiduals:
        """The same with collocation points (n_points,) of each record; first and last are its ends."""
        own = TrainingResiduals.of(self, self.problem, self.make_ansatz)
        own.shift = self.shift
        own.blocks = [
            _placed(block, record, times, self.system.n_dof, omega)
            for block, record, times in zip(self.blocks, self.problem.records, points, strict=True)
        ]
        own.ansatzes = [self.make_ansatz(k, block) for k, block in enumerate(own.blocks)]
        return own

    def _rows(self, outputs: Sequence[Tensor], physics: Sequence[Tensor], logs: Tensor, offsets: Tensor) -> Tensor:
        rows = super()._rows(outputs, physics, logs, offsets)
        return rows if self.shift is None else rows + self.shift


def _placed(block: Block, record: Record, times: np.ndarray, n_dof: int, omega: float) -> Block:
    """A block whose collocation points are ``times``."""
    own = block.take(torch.zeros(1, dtype=torch.long, device=block.values.device))
    own.times = np.concatenate([times, block.times[0, block.collocation :]])[None]
    force = record.force(times, n_dof)
    own.force = [torch.as_tensor(np.array(part)[None], device=block.values.device) for part in force]
    if block.lift is not None:
        start = record.initial_state
        assert start is not None
        told = np.stack([start.displacement, start.velocity])[None]
        lift, shape = exact_start(own.times, told, np.array([omega]))
        own.lift = torch.as_tensor(lift, device=block.values.device)
        own.shape = torch.as_tensor(shape, device=block.values.device)
    return own
