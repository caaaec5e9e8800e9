"""One fit of the family: the engine's residuals of one problem, trained as the settings say, with its path noted."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from bench import Problem
from methods.network.ansatz import Sum
from methods.network.tanh import Network
from methods.pinn.block import Spread
from methods.pinn.engine import Attempt, Fit, Watch, torch_threads
from methods.pinn.levenberg import DualEquations, Walk, equations, minimise
from methods.pinn.residuals import Residuals
from methods.pinn_family.architectures import FeatureAnsatz
from methods.pinn_family.loss import Loss, best_of
from methods.pinn_family.optimisers import first_order, gauss_newton, newton_cg, projection, quasi_newton
from methods.pinn_family.path import Path
from methods.pinn_family.residuals import TrainingResiduals
from methods.pinn_family.sampling import SAMPLINGS
from methods.pinn_family.weighting import WEIGHTINGS, Sizes
from methods.starts.waves import Guess

if TYPE_CHECKING:
    from methods.pinn_family.settings import FamilySettings

STAGES = ((30.0, 0.1), (1.0, 0.2), (1.0, 0.7))
"""How soft the physics is and which share of the work it takes, stage by stage, where the noise is estimated."""
ADAM_SHARE = 0.3
"""Share of a stage's work that Adam gets before L-BFGS or another second method."""
ROUNDS, SETTLED = 3, 0.03
"""As the engine: how often the last stage may be run again with a noise that has changed by more than this."""
POLISH, POLISHED = 50, 1e-6
"""Steps of Levenberg-Marquardt to the minimum that a training is judged by, and the promise over the loss to end at."""
RATES = {"adam": 3e-3, "soap": 3e-3, "muon": 1e-2, "adam_lbfgs": 1e-3}
"""First learning rates: the paper's where Adam hands over, else the best of 1e-3, 3e-3 and 1e-2 on one system."""
PARTNER = {"adam_lbfgs": "lbfgs", "nystrom_newton_cg": "newton_cg"}


class FamilyAttempt(Attempt):
    """One problem's fit; see the module. Only one at a time, since each optimiser goes its own way."""

    def __init__(
        self,
        problem: Problem,
        guess: Guess,
        settings: FamilySettings,
        rng: np.random.Generator,
        watch: Watch,
        path: Path,
    ) -> None:
        super().__init__([problem], [guess], settings, [rng], watch)
        self.own, self.rng, self.path = settings, rng, path
        self.residuals = TrainingResiduals.of(self.residuals, problem, self._ansatz)
        sizes = Sizes(self._plain_deviations(), lambda softness: self.residuals.deviations(self.spread(softness)))
        self.loss = Loss(
            self.residuals,
            WEIGHTINGS[settings.weighting](sizes, self.residuals),
            SAMPLINGS[settings.sampling](float(self.omega[0]), rng),
            path,
        )

    def _plain_deviations(self) -> Tensor:
        """What takes the dimension off the rows: a wave of the data's size and of the scan's frequency."""
        size = np.max(self.rms * self.to_displacement, 1)
        return self.residuals.deviations(
            Spread(self.rms, self.omega**2 * size, self.omega**2 * size, size, self.omega * size)
        )

    def train(self) -> None:
        """All stages; the noise is estimated after each."""
        loss, everyone = self.loss, np.arange(1)
        z = self.walk.z[0]
        loss.path.note(loss.first, z[None], 0.0)
        stages = STAGES if self.own.weighting == "noise" else ((1.0, 1.0),)
        for number, (softness, share) in enumerate(stages):
            last = number == len(stages) - 1
            for _ in range(ROUNDS if last else 1):
                left = self.own.budget - loss.work
                work = share * self.own.budget if not last else left
                if work <= 0:
                    break
                loss.weighting.begin(softness)
                loss.moving = True
                loss.begin(work)
                z = self._minimise(z, last)
                self.walk.z = z[None].clone()
                change = self._noise(everyone)
                self.watch(self.results)
                if change < SETTLED:
                    break
        loss.path.note(loss.first, z[None], loss.work)
        self.walk.evaluations[0] = loss.gradients
        self.walk.iterations[0] = loss.gradients
        self.walk.converged[0] = loss.work < self.own.budget
        ended = "it found no further decrease" if self.walk.converged[0] else "the budget of work was used up"
        self.walk.reasons[0] = ended

    def _noise(self, who: np.ndarray) -> float:
        """Estimate the noise where the training stands; returns how much it changed."""
        deviations = self.residuals.deviations(self.spread())
        return float(self.estimate_noise(self.residuals, deviations, who)[0])

    def _minimise(self, z: Tensor, last: bool) -> Tensor:
        """One stage by the optimiser of the settings."""
        name, loss = str(self.own.optimizer), self.loss
        if name in PARTNER:
            end = loss.limit
            loss.begin(ADAM_SHARE * (end - loss.work))
            z = best_of(loss, z, self._steps("adam"))
            loss.begin(end - loss.work)
            name = PARTNER[name]
        if name == "lm" and not last:
            return self._on_heads(z)
        z = best_of(loss, z, self._steps(name))
        while loss.moving and loss.adaptive and loss.work < loss.limit:  # it converged before the weights settled
            z = best_of(loss, z, self._steps(name))
        return z

    def _steps(self, name: str) -> Callable[[Loss, Tensor], Tensor]:
        """The optimiser of a name."""
        shapes = self._shapes()
        rate = self.own.rate or RATES.get(self.own.optimizer, RATES["adam_lbfgs"])
        makers: Mapping[str, Callable[[Loss, Tensor], Tensor]] = {
            "adam": lambda loss, z: first_order.adam(loss, z, shapes, rate),
            "soap": lambda loss, z: first_order.soap(loss, z, shapes, rate),
            "muon": lambda loss, z: first_order.muon(loss, z, shapes, rate),
            "lbfgs": quasi_newton.lbfgs,
            "self_scaled_bfgs": lambda loss, z: quasi_newton.self_scaled(loss, z, "bfgs"),
            "self_scaled_broyden": lambda loss, z: quasi_newton.self_scaled(loss, z, "broyden"),
            "newton_cg": lambda loss, z: newton_cg.nystrom_newton_cg(loss, z, int(self.rng.integers(2**31))),
            "natural_gradient": lambda loss, z: gauss_newton.natural_gradient(loss, z, 1e-6),
            "variable_projection": lambda loss, z: projection.variable_projection(loss, z, 1e-9),
            "lm": self._levenberg_marquardt,
        }
        return makers[name]

    def _levenberg_marquardt(self, loss: Loss, z: Tensor) -> Tensor:
        """It ends by the log posterior where the loss is one, else by the loss itself."""
        if self.own.weighting == "noise":
            return gauss_newton.levenberg_marquardt(loss, z, absolute=self.own.tolerance)
        return gauss_newton.levenberg_marquardt(loss, z, relative=1e-6)

    def _shapes(self) -> list[tuple[int, ...]]:
        """Shapes of the coefficients, layer by layer, and of the other unknowns, in the order of z."""
        shapes: list[tuple[int, ...]] = []
        for ansatz in self.residuals.ansatzes:
            shapes += _ansatz_shapes(ansatz)
        return [*shapes, (self.residuals.n_unknowns,)] if self.residuals.n_unknowns else shapes

    def _on_heads(self, z: Tensor) -> Tensor:
        """Levenberg-Marquardt on the output layer alone, as the engine begins."""
        whole, loss = self.residuals, self.loss
        heads, short = whole.heads(z[None])
        loss.moving = False
        loss.residuals, loss.expand = heads, lambda own: whole.with_heads(z[None], own[None])[0]  # type: ignore[assignment]
        try:
            found = best_of(loss, short[0], self._levenberg_marquardt)
            return loss.expand(found)
        finally:
            loss.residuals, loss.expand, loss.best = whole, lambda own: own, None

    def judged(self) -> Mapping[str, np.ndarray]:
        """The path, and how far its end is from the minimum of the loss at the weights of the end.

        The minimum is where Levenberg-Marquardt goes from there, on the first grid. ``certificate``: the gradient over
        the product of the lengths of Jacobian and residual, a cosine that is zero at a minimum.
        """
        residuals = self.residuals
        deviations = self.loss.deviations
        state = residuals.evaluate(self.walk.z, deviations)
        walk = Walk.start(self.walk.z, 1e-6)
        loss = float(state.loss[0])
        minimise(residuals, walk, deviations, POLISH, max(POLISHED * loss, 1e-12))
        least = float(residuals.evaluate(walk.z, deviations).loss[0])
        logs = np.asarray(residuals.split(walk.z)[1][0].cpu())
        return {
            **self.path.traces(deviations),
            "minimum_loss": np.array([min(least, loss)]),
            "minimum_parameters": np.exp(logs),
            "certificate": np.array([certificate(residuals, self.walk.z, deviations)]),
        }


def _ansatz_shapes(ansatz: object) -> list[tuple[int, ...]]:
    if isinstance(ansatz, Sum):
        return [*_ansatz_shapes(ansatz.inner), (ansatz.fixed.count,)]
    if isinstance(ansatz, Network):
        pairs = zip(ansatz.widths, ansatz.widths[1:], strict=False)
        return [shape for n_in, n_out in pairs for shape in ((n_out, n_in), (n_out,))]
    if isinstance(ansatz, FeatureAnsatz):
        return [*ansatz.shapes, (ansatz.n_paths, (ansatz.count - ansatz.body) // ansatz.n_paths)]
    return [(ansatz.count,)]  # type: ignore[attr-defined]


def certificate(residuals: Residuals, z: Tensor, deviations: Tensor) -> float:
    """``‖Jᵀ r‖ / (‖J‖ ‖r‖)`` at z (1, n_z), with the Frobenius norm of J."""
    state = residuals.evaluate(z, deviations)
    normal = equations(residuals, state, deviations)
    linear = residuals.linearise(state, deviations)
    gradient = residuals.pull_back(state, linear, state.rows)
    matrix = normal.gram if isinstance(normal, DualEquations) else normal.matrix
    size = math.sqrt(float(matrix.diagonal(dim1=1, dim2=2).sum()))
    return float(gradient.norm()) / max(size * float(state.rows.norm()), 1e-300)


@dataclass(eq=False)
class TrainedFit(Fit):
    """A fit that remembers its training. ``draws`` (n, n_parameters): log-parameters, where draws are the belief."""

    attempt: FamilyAttempt | None = None
    draws: np.ndarray | None = None

    @staticmethod
    def of(fit: Fit, attempt: FamilyAttempt) -> TrainedFit:
        """The same fit with its training."""
        return TrainedFit(**{**vars(fit), "attempt": attempt})


def fit(
    problem: Problem, guess: Guess, settings: FamilySettings, rng: np.random.Generator, path: Path, watch: Watch
) -> tuple[TrainedFit, float]:
    """One attempt from a starting guess, and its work; the fit's history carries the path and its judgement."""
    with torch_threads(settings.threads), torch.no_grad():
        attempt = FamilyAttempt(problem, guess, settings, rng, watch, path)
        attempt.record()
        attempt.train()
        attempt.record()
        found = attempt.results()[0]
        found.history = {**found.history, **attempt.judged()}
        return TrainedFit.of(found, attempt), attempt.loss.work
