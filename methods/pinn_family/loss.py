"""The loss of the family, half the squared weighted residual vector, and the base class of optimisers.

The budget is counted in gradients, so that a training is the same on every machine; other operations have the relative
:data:`COSTS` measured on the reference network.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from methods.pinn.equations import NormalEquations, equations
from methods.pinn.residuals import Residuals, State
from methods.pinn_family.choices import TrainingComponent
from methods.pinn_family.sampling import Sampling
from methods.pinn_family.weighting import Weighting

COSTS = {"value": 0.3, "gradient": 1.0, "equations": 5.0, "matrix": 8e-7}
"""Work, in gradients, of a loss, a gradient, a linearisation with its matrix, and one access to an entry of a dense
matrix."""
FIRST_MOVE, LAST_MOVE = 5, 35
"""Range of least-squares steps in which weights and points are updated. At rest, where training begins, no equation is
violated and weights would be meaningless."""
NEGLIGIBLE = 1e-6
"""Relative decrease of a loss that is negligible, where the loss is not a log posterior."""
GROWTH = 1.15
"""Ratio of the work at successive entries of a path."""


class Exhausted(Exception):
    """Raised when the work of a stage is used up; the loss has its best point."""


class TrainingPath:
    """History of a training: processor time (s), log-parameters, and the unweighted residual vector on the first grid.

    The time is relative to ``begun`` (:func:`time.process_time`) and excludes the recording itself.
    """

    def __init__(self, begun: float) -> None:
        self.begun, self.due = begun, 0.0
        self.seconds: list[float] = []
        self.logs: list[np.ndarray] = []
        self.rows: list[np.ndarray] = []

    def note(self, residuals: Residuals, z: Tensor, work: float) -> None:
        """Record the point z (1, n_z), and set the work at which the next entry is due."""
        now = time.process_time()
        self.seconds.append(now - self.begun)
        ones = torch.ones(1, residuals.n_rows, dtype=torch.float64, device=residuals.device)
        self.rows.append(plain(residuals.evaluate(z, ones).rows[0]))
        self.logs.append(plain(residuals.split(z)[1][0]))
        self.due = GROWTH * max(work, 1.0)
        self.begun += time.process_time() - now

    def traces(self, deviations: Tensor) -> Mapping[str, np.ndarray]:
        """Return the path as arrays, with the loss for ``deviations`` (1, n_rows)."""
        scaled = np.array(self.rows) / plain(deviations[0])
        return {
            "path_cpu_s": np.array(self.seconds),
            "path_parameters": np.exp(np.array(self.logs)),
            "path_loss": 0.5 * np.sum(scaled**2, 1),
        }


class Loss:
    """The loss of one problem at the current weights and collocation points, as a function of z (n_z,).

    Args:
        residuals: The residual vector on the first grid, used for the path.
        weighting: The weights of the rows, possibly changing during training.
        sampling: The collocation points, possibly changing during training.
        path: The history of the training.
        shapes: Shapes of the parts of z: coefficients of the layers, and the other unknowns.
        tolerance: Negligible decrease of the loss where it is a log posterior; None otherwise.
    """

    def __init__(
        self,
        residuals: Residuals,
        weighting: Weighting,
        sampling: Sampling,
        path: TrainingPath,
        shapes: Sequence[tuple[int, ...]],
        tolerance: float | None,
    ) -> None:
        self.first = self.residuals = residuals
        self.weighting, self.sampling, self.path = weighting, sampling, path
        self.shapes, self.tolerance = shapes, tolerance
        self.work, self.limit, self.stage_begun = 0.0, np.inf, 0.0
        self.gradients = self.steps = 0
        self.adaptive = weighting.every + sampling.every > 0
        self.moving = True
        self.best: tuple[float, Tensor] | None = None
        self.expand: Callable[[Tensor], Tensor] = lambda z: z

    @property
    def deviations(self) -> Tensor:
        """Return the standard deviations of the rows, (1, n_rows); a weight w divides one by its square root."""
        return self.weighting.deviations

    @property
    def progress(self) -> float:
        """Return the share of the stage's work that is done."""
        return min(1.0, (self.work - self.stage_begun) / max(self.limit - self.stage_begun, 1e-9))

    def negligible(self, value: float) -> float:
        """Return the negligible decrease of a loss of this value."""
        return max(NEGLIGIBLE * value if self.tolerance is None else self.tolerance, 1e-300)

    def begin(self, work: float) -> None:
        """Begin a stage with a given work; the best point, of other weights, is reset."""
        self.stage_begun, self.limit, self.best = self.work, self.work + work, None

    def charge(self, work: float) -> None:
        """Count work; raises Exhausted when that of the stage is used up."""
        self.work += work
        if self.work >= self.limit:
            raise Exhausted

    def value(self, z: Tensor) -> float:
        """Return the loss without its gradient."""
        self.charge(COSTS["value"])
        return self.record(z, self.residuals.evaluate(z[None], self.deviations))

    def gradient(self, z: Tensor) -> tuple[float, Tensor]:
        """Return the loss and its gradient (n_z,)."""
        state, gradient = self.residuals.gradient(z[None], self.deviations)
        value = self.record(z, state)
        self.gradients += 1
        self._move(z, state, self.gradients)
        self.charge(COSTS["gradient"])
        return value, gradient[0]

    def equations(self, z: Tensor) -> tuple[State, NormalEquations]:
        """Return the state and the normal equations at z."""
        self.charge(COSTS["equations"])
        state = self.residuals.evaluate(z[None], self.deviations)
        if self.moving and self.adaptive:
            self.steps += 1
            if self.steps > FIRST_MOVE:
                self._move(z, state)
            self.moving = self.steps < LAST_MOVE
            state = self.residuals.evaluate(z[None], self.deviations)
        self.record(z, state)
        return state, equations(self.residuals, state, self.deviations)

    def _move(self, z: Tensor, state: State, count: int = 0) -> None:
        """Update the weights and points that are due after ``count`` gradients; at 0 all that are adaptive."""
        weigh, sample = (every > 0 and count % every == 0 for every in (self.weighting.every, self.sampling.every))
        if not self.moving or not (weigh or sample):
            return
        if weigh:
            self.weighting.move(self.residuals, state)
        if sample:
            self.residuals = self.sampling.moved(self.first, z)
        self.residuals.shift = self.weighting.shift
        self.best = None

    def freeze(self) -> None:
        """Stop updates of weights and points, since a line search requires a fixed function."""
        self.moving, self.best = False, None

    def record(self, z: Tensor, state: State) -> float:
        """Record a point with its state; return its loss."""
        value = float(state.loss[0])
        if np.isfinite(value) and (self.best is None or value < self.best[0]):
            self.best = value, z.detach().clone()
        if self.work >= self.path.due and self.best is not None:
            self.path.note(self.first, self.expand(self.best[1])[None], self.work)
        return value


class Optimizer(TrainingComponent, ABC):
    """Base class of optimisers, with an initial learning ``rate`` if any and a random generator ``rng``.

    ``method.rate`` replaces the ``rate`` of the class. With ``adam_first``, Adam is run first with a share of the work.
    """

    rate: float = 1e-3
    adam_first: ClassVar[bool] = False

    def __init__(self, rate: float | None, rng: np.random.Generator) -> None:
        self.rate = rate or type(self).rate
        self.rng = rng

    @abstractmethod
    def minimise(self, loss: Loss, z: Tensor) -> Tensor:
        """Minimise from z; return the unknowns (n_z,) of the least loss.

        ``loss.gradient(z)`` returns the loss and its gradient, ``loss.value(z)`` the loss alone. Both raise
        :class:`Exhausted` when the work is used up, which must not be caught: the best point recorded is then returned.
        ``loss.progress`` is the share of the work that is done, ``loss.shapes`` the shapes of the parts of z.
        """


def best_of(loss: Loss, z: Tensor, optimizer: Optimizer) -> Tensor:
    """Run an optimiser from z within the stage's work; return its result, or the best point recorded."""
    try:
        return optimizer.minimise(loss, z)
    except Exhausted:
        return loss.best[1] if loss.best is not None else z


def plain(z: Tensor) -> np.ndarray:
    """Convert a tensor to NumPy."""
    return np.asarray(z.detach().cpu())


def tensor(values: np.ndarray, like: Tensor) -> Tensor:
    """Convert a NumPy vector to a tensor on the device of another."""
    return torch.as_tensor(values, dtype=torch.float64, device=like.device)
