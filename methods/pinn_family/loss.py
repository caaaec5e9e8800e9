"""What every optimiser of the family minimises: half the squared, weighted residual vector, with a budget of work.

The budget is counted in gradients, so that a training is the same on every machine; what else an optimiser does is
counted by what it costs beside one (:data:`COSTS`, measured on the reference network). Seconds are noted, never asked.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from methods.pinn.levenberg import DualEquations, PrimalEquations, equations
from methods.pinn.residuals import Residuals, State
from methods.pinn_family.path import Path
from methods.pinn_family.residuals import TrainingResiduals
from methods.pinn_family.sampling import Sampling
from methods.pinn_family.weighting import Weighting

COSTS = {"value": 0.3, "gradient": 1.0, "equations": 5.0, "matrix": 8e-7}
"""Work in gradients: of a value, a gradient, a linearisation with its matrix, and of an entry of a dense matrix that
is read and written once."""


MOVES = 30
"""How often weights and points move where the optimiser takes least-squares steps: before each of the first ones."""


FIRST_MOVE = 5
"""Steps before the first of these: at rest, where training begins, no equation is violated and no weight is right."""


class Exhausted(Exception):
    """Raised where the work of a stage is used up; the loss holds the best point of it."""


class Loss:
    """One problem's loss at the present weights and collocation points, as a function of z (n_z,).

    Args:
        residuals: The residual vector on the first grid, on which the path is noted.
        weighting: What gives the rows their weights, and may change them as training goes on.
        sampling: What moves the collocation points, if anything does.
        path: Notes where the training is.
    """

    def __init__(self, residuals: TrainingResiduals, weighting: Weighting, sampling: Sampling, path: Path) -> None:
        self.first = residuals
        self.residuals: Residuals = residuals
        self.weighting, self.sampling, self.path = weighting, sampling, path
        self.work, self.limit = 0.0, np.inf
        self.gradients = self.moves = 0
        self.stage_begun = 0.0
        self.moving = True
        self.best: tuple[float, Tensor] | None = None
        self.expand: Callable[[Tensor], Tensor] = lambda z: z

    @property
    def deviations(self) -> Tensor:
        """Standard deviations of the rows, (1, n_rows): a weight w is a deviation divided by its square root."""
        return self.weighting.deviations

    @property
    def progress(self) -> float:
        """The share of the stage's work that is done."""
        return min(1.0, (self.work - self.stage_begun) / max(self.limit - self.stage_begun, 1e-9))

    def begin(self, work: float) -> None:
        """A stage of so much work begins: what was best at other weights is forgotten."""
        self.stage_begun, self.limit, self.best = self.work, self.work + work, None

    def charge(self, work: float) -> None:
        """Count work; raises Exhausted where the stage's is used up."""
        self.work += work
        if self.work >= self.limit:
            raise Exhausted

    def value(self, z: Tensor) -> float:
        """The loss alone."""
        self.charge(COSTS["value"])
        state = self.residuals.evaluate(z[None], self.deviations)
        return self.seen(z, state)

    def gradient(self, z: Tensor) -> tuple[float, Tensor]:
        """The loss and its gradient (n_z,)."""
        state, gradient = self.residuals.gradient(z[None], self.deviations)
        value = self.seen(z, state)
        self.gradients += 1
        if self.moving:
            self.adapt(z, state)
        self.charge(COSTS["gradient"])
        return value, gradient[0]

    def equations(self, z: Tensor) -> tuple[State, DualEquations | PrimalEquations]:
        """The state and the normal equations at z."""
        self.charge(COSTS["equations"])
        state = self.residuals.evaluate(z[None], self.deviations)
        if self.moving and self.adaptive:
            self.moves += 1
            if self.moves > FIRST_MOVE:
                self._move(z, state, self.weighting.every > 0, self.sampling.every > 0)
            self.moving = self.moves < FIRST_MOVE + MOVES
            state = self.residuals.evaluate(z[None], self.deviations)
        self.seen(z, state)
        return state, equations(self.residuals, state, self.deviations)

    @property
    def adaptive(self) -> bool:
        """Whether weights or points move at all."""
        return self.weighting.every + self.sampling.every > 0

    def adapt(self, z: Tensor, state: State) -> None:
        """Let weights and points move, where it is time."""
        weigh, sample = (
            every > 0 and self.gradients % every == 0 for every in (self.weighting.every, self.sampling.every)
        )
        if weigh or sample:
            self._move(z, state, weigh, sample)

    def _move(self, z: Tensor, state: State, weigh: bool, sample: bool) -> None:
        assert isinstance(self.residuals, TrainingResiduals)  # the output layer's alone are never moved
        if weigh:
            self.weighting.update(self.residuals, state)
            self.residuals.shift = self.weighting.shift
        if sample:
            self.residuals = self.sampling.moved(self.residuals, z)
        self.best = None

    def freeze(self) -> None:
        """From here on weights and points stay: a line search needs one and the same function."""
        self.moving, self.best = False, None

    def seen(self, z: Tensor, state: State) -> float:
        """Note a point whose state is known; returns its loss."""
        value = float(state.loss[0])
        if np.isfinite(value) and (self.best is None or value < self.best[0]):
            self.best = value, z.detach().clone()
        if self.path.due(self.work) and self.best is not None:
            self.path.note(self.first, self.expand(self.best[1])[None], self.work)
        return value


def best_of(loss: Loss, z: Tensor, minimise: Callable[[Loss, Tensor], Tensor]) -> Tensor:
    """What a minimiser reaches from z within the stage's work: its answer, or the best point it saw."""
    try:
        return minimise(loss, z)
    except Exhausted:
        return loss.best[1] if loss.best is not None else z


def plain(z: Tensor) -> np.ndarray:
    """A vector as numpy."""
    return np.asarray(z.detach().cpu())


def tensor(values: np.ndarray, like: Tensor) -> Tensor:
    """A numpy vector on the device of another."""
    return torch.as_tensor(values, dtype=torch.float64, device=like.device)
