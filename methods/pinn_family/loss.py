"""What every optimiser of the family minimises, half the squared, weighted residual vector, and their base class.

The budget is counted in gradients, so that a training is the same on every machine; what else an optimiser does is
counted by what it costs beside one (:data:`COSTS`, measured on the reference network).
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
"""Work in gradients: of a value, a gradient, a linearisation with its matrix, and of an entry of a dense matrix that
is read and written once."""
FIRST_MOVE, LAST_MOVE = 5, 35
"""Least-squares steps between which weights and points move before each: at rest, where training begins, no equation
is violated and no weight is right."""
NEGLIGIBLE = 1e-6
"""Share of a loss below which a decrease is negligible, where the loss is no log posterior."""
GROWTH = 1.15
"""Work from one record of a path to the next, as a factor: moments are evenly spaced in its logarithm."""


class Exhausted(Exception):
    """Raised where the work of a stage is used up; the loss holds the best point of it."""


class TrainingPath:
    """Moments of a training: processor seconds, log-parameters, and the plain residual vector on the first grid.

    Seconds count from ``begun`` on, a time of :func:`time.process_time`, without those that noting itself takes.
    """

    def __init__(self, begun: float) -> None:
        self.begun, self.due = begun, 0.0
        self.seconds: list[float] = []
        self.logs: list[np.ndarray] = []
        self.rows: list[np.ndarray] = []

    def note(self, residuals: Residuals, z: Tensor, work: float) -> None:
        """Note where z (1, n_z) is; after how much work the next note is due follows."""
        now = time.process_time()
        self.seconds.append(now - self.begun)
        ones = torch.ones(1, residuals.n_rows, dtype=torch.float64, device=residuals.device)
        self.rows.append(plain(residuals.evaluate(z, ones).rows[0]))
        self.logs.append(plain(residuals.split(z)[1][0]))
        self.due = GROWTH * max(work, 1.0)
        self.begun += time.process_time() - now

    def traces(self, deviations: Tensor) -> Mapping[str, np.ndarray]:
        """Return the path as arrays; the loss is at the weights that ``deviations`` (1, n_rows) state."""
        scaled = np.array(self.rows) / plain(deviations[0])
        return {
            "path_cpu_s": np.array(self.seconds),
            "path_parameters": np.exp(np.array(self.logs)),
            "path_loss": 0.5 * np.sum(scaled**2, 1),
        }


class Loss:
    """One problem's loss at the present weights and collocation points, as a function of z (n_z,).

    Args:
        residuals: The residual vector on the first grid, on which the path is noted.
        weighting: What gives the rows their weights, and may change them as training goes on.
        sampling: What moves the collocation points, if anything does.
        path: Notes where the training is.
        shapes: Shapes of the parts of z: coefficients layer by layer, and the other unknowns.
        tolerance: A decrease that is negligible where the loss is a log posterior; None where it is none.
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
        """Standard deviations of the rows, (1, n_rows): a weight w is a deviation divided by its square root."""
        return self.weighting.deviations

    @property
    def progress(self) -> float:
        """The share of the stage's work that is done."""
        return min(1.0, (self.work - self.stage_begun) / max(self.limit - self.stage_begun, 1e-9))

    def negligible(self, value: float) -> float:
        """Return the decrease of a loss of this value that is not worth a step."""
        return max(NEGLIGIBLE * value if self.tolerance is None else self.tolerance, 1e-300)

    def begin(self, work: float) -> None:
        """Begin a stage of so much work; what was best at other weights is forgotten."""
        self.stage_begun, self.limit, self.best = self.work, self.work + work, None

    def charge(self, work: float) -> None:
        """Count work; raises Exhausted where the stage's is used up."""
        self.work += work
        if self.work >= self.limit:
            raise Exhausted

    def value(self, z: Tensor) -> float:
        """Return the loss alone."""
        self.charge(COSTS["value"])
        return self.seen(z, self.residuals.evaluate(z[None], self.deviations))

    def gradient(self, z: Tensor) -> tuple[float, Tensor]:
        """Return the loss and its gradient (n_z,)."""
        state, gradient = self.residuals.gradient(z[None], self.deviations)
        value = self.seen(z, state)
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
        self.seen(z, state)
        return state, equations(self.residuals, state, self.deviations)

    def _move(self, z: Tensor, state: State, count: int = 0) -> None:
        """Move the weights and points that are due after so many gradients; at a count of 0 all that ever move."""
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
        """Let weights and points stay from here on: a line search needs one and the same function."""
        self.moving, self.best = False, None

    def seen(self, z: Tensor, state: State) -> float:
        """Note a point whose state is known; returns its loss."""
        value = float(state.loss[0])
        if np.isfinite(value) and (self.best is None or value < self.best[0]):
            self.best = value, z.detach().clone()
        if self.work >= self.path.due and self.best is not None:
            self.path.note(self.first, self.expand(self.best[1])[None], self.work)
        return value


class Optimizer(TrainingComponent, ABC):
    """A way to the minimum of a loss, with a first learning ``rate`` where it has any; ``rng`` is all its randomness.

    The ``rate`` of the class is what ``method.rate`` replaces. Where ``adam_first``, Adam has a share of the work
    before.
    """

    rate: float = 1e-3
    adam_first: ClassVar[bool] = False

    def __init__(self, rate: float | None, rng: np.random.Generator) -> None:
        self.rate = rate or type(self).rate
        self.rng = rng

    @abstractmethod
    def minimise(self, loss: Loss, z: Tensor) -> Tensor:
        """Return the unknowns (n_z,) at the least loss found, from z on.

        ``loss.gradient(z)`` gives the loss and its gradient, ``loss.value(z)`` the loss alone. Both raise
        :class:`Exhausted` where the work is used up; let it pass: the best point seen is then the answer.
        ``loss.progress`` is the share of the work that is done, ``loss.shapes`` the shapes of the parts of z.
        """


def best_of(loss: Loss, z: Tensor, optimizer: Optimizer) -> Tensor:
    """Return what an optimiser reaches from z within the stage's work: its answer, or the best point it saw."""
    try:
        return optimizer.minimise(loss, z)
    except Exhausted:
        return loss.best[1] if loss.best is not None else z


def plain(z: Tensor) -> np.ndarray:
    """Return a vector as numpy has it."""
    return np.asarray(z.detach().cpu())


def tensor(values: np.ndarray, like: Tensor) -> Tensor:
    """Return a numpy vector on the device of another."""
    return torch.as_tensor(values, dtype=torch.float64, device=like.device)
