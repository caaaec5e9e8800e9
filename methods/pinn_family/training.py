"""Training of one problem by the settings of the family, and its posterior."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from bench import Problem
from methods.network.ansatz import Ansatz, SumAnsatz
from methods.network.response import Band, Function
from methods.network.tanh import Network
from methods.pinn.block import Spread
from methods.pinn.engine import Attempt, Watch, torch_threads
from methods.pinn.equations import equations
from methods.pinn.levenberg import Walk, minimise
from methods.pinn.task import Fit
from methods.pinn_family.architectures import FeatureAnsatz
from methods.pinn_family.choices import OPTIMIZERS, WEIGHTINGS
from methods.pinn_family.loss import Loss, TrainingPath, best_of, plain
from methods.pinn_family.optimizers import Adam, LevenbergMarquardt
from methods.pinn_family.sampling import SAMPLINGS
from methods.starts.waves import Guess

if TYPE_CHECKING:
    from methods.pinn_family.settings import FamilySettings

STAGES = ((30.0, 0.1), (1.0, 0.2), (1.0, 0.7))
"""Softness of the physics and share of the work of each stage, where the noise is estimated."""
ADAM_SHARE = 0.3
"""Share of a stage's work for Adam before another optimiser."""
ROUNDS, SETTLED = 3, 0.03
"""Largest number of runs of the last stage, repeated while the noise changes by more than this."""
POLISH, POLISHED = 50, 1e-6
"""Levenberg-Marquardt steps to the reference minimum, and the relative predicted decrease at which they end."""
CURVES = 50
"""Largest number of responses averaged in a reconstruction."""


class FamilyAttempt(Attempt):
    """The training of one problem."""

    def __init__(
        self,
        problem: Problem,
        guess: Guess,
        settings: FamilySettings,
        rng: np.random.Generator,
        watch: Watch,
        path: TrainingPath,
    ) -> None:
        super().__init__([problem], [guess], settings, [rng], watch)
        self.family, self.rng = settings, rng
        self.by_noise = settings.weighting == "noise"
        self.optimizer = OPTIMIZERS.load(settings.optimizer)(settings.rate, rng)
        self.loss = Loss(
            self.residuals,
            WEIGHTINGS.load(settings.weighting)(self._sizes(), self.residuals),
            SAMPLINGS[settings.sampling](problem, self._ansatz, float(self.omega[0]), rng),
            path,
            self._shapes(),
            settings.tolerance if self.by_noise else None,
        )

    def _sizes(self) -> Tensor:
        """Return the scales of the rows, from a wave of the data's size and of the scan's frequency."""
        size = np.max(self.rms * self.to_displacement, 1)
        acceleration = self.omega**2 * size
        return self.residuals.deviations(Spread(self.rms, acceleration, acceleration, size, self.omega * size))

    def _shapes(self) -> list[tuple[int, ...]]:
        """Return the shapes of the layers' coefficients and of the other unknowns, in the order of z."""
        shapes = [shape for ansatz in self.residuals.ansatzes for shape in _ansatz_shapes(ansatz)]
        return [*shapes, (self.residuals.n_unknowns,)] if self.residuals.n_unknowns else shapes

    def train(self) -> None:
        """Run all stages; the noise is estimated after each."""
        loss, budget = self.loss, self.family.budget
        z = self.walk.z[0]
        loss.path.note(loss.first, z[None], 0.0)
        stages = STAGES if self.by_noise else ((1.0, 1.0),)
        for number, (softness, share) in enumerate(stages):
            last = number == len(stages) - 1
            for _ in range(ROUNDS if last else 1):
                work = budget - loss.work if last else share * budget
                if work <= 0:
                    break
                loss.weighting.begin(self.residuals.deviations(self.spread(softness)))
                loss.moving = True
                loss.begin(work)
                z = self._minimise(z, last)
                self.walk.z = z[None].clone()
                deviations = self.residuals.deviations(self.spread())
                change = float(self.estimate_noise(self.residuals, deviations, np.arange(1))[0])
                self.watch(self.results)
                if change < SETTLED:
                    break
        loss.path.note(loss.first, z[None], loss.work)
        self.walk.evaluations[0] = self.walk.iterations[0] = loss.gradients
        ended = "" if loss.work < budget else "the budget of work was used up"
        self.walk.reasons[0] = ended

    def _minimise(self, z: Tensor, last: bool) -> Tensor:
        """Run one stage with the optimiser of the settings."""
        loss, optimizer = self.loss, self.optimizer
        if optimizer.adam_first:
            end = loss.limit
            loss.begin(ADAM_SHARE * (end - loss.work))
            z = best_of(loss, z, Adam(optimizer.rate, self.rng))
            loss.begin(end - loss.work)
        if isinstance(optimizer, LevenbergMarquardt) and not last:
            return self._on_heads(z)
        z = best_of(loss, z, optimizer)
        while loss.moving and loss.adaptive and loss.work < loss.limit:  # converged before the weights
            z = best_of(loss, z, optimizer)
        return z

    def _on_heads(self, z: Tensor) -> Tensor:
        """Optimise the output layer only."""
        whole, loss = self.residuals, self.loss
        heads, short = whole.heads(z[None])
        loss.moving = False
        loss.residuals, loss.expand = heads, lambda layer: whole.with_heads(z[None], layer[None])[0]
        try:
            return loss.expand(best_of(loss, short[0], self.optimizer))
        finally:
            loss.residuals, loss.expand, loss.best = whole, lambda point: point, None

    def path_traces(self) -> Mapping[str, np.ndarray]:
        """Return the path, and the distance of its end from a minimum of the loss at the final weights.

        The minimum is found by Levenberg-Marquardt from the end, on the first grid. ``certificate``: ``‖Jᵀ r‖ / (‖J‖
        ‖r‖)`` with the Frobenius norm of J, zero at a minimum.
        """
        residuals, deviations = self.residuals, self.loss.deviations
        state = residuals.evaluate(self.walk.z, deviations)
        size = math.sqrt(float(equations(residuals, state, deviations).trace)) * float(state.rows.norm())
        gradient = residuals.pull_back(state, residuals.linearise(state, deviations), state.rows)
        walk, loss = Walk(self.walk.z, 1e-6), float(state.loss[0])
        minimise(residuals, walk, deviations, POLISH, max(POLISHED * loss, 1e-12))
        least = float(residuals.evaluate(walk.z, deviations).loss[0])
        return {
            **self.loss.path.traces(deviations),
            "minimum_loss": np.array([min(least, loss)]),
            "minimum_parameters": np.exp(plain(residuals.split(walk.z)[1][0])),
            "certificate": np.array([float(gradient.norm()) / max(size, 1e-300)]),
        }


def _ansatz_shapes(ansatz: Ansatz) -> list[tuple[int, ...]]:
    if isinstance(ansatz, SumAnsatz):
        return [*_ansatz_shapes(ansatz.inner), (ansatz.fixed.count,)]
    if isinstance(ansatz, Network):
        pairs = zip(ansatz.widths, ansatz.widths[1:], strict=False)
        return [shape for n_in, n_out in pairs for shape in ((n_out, n_in), (n_out,))]
    if isinstance(ansatz, FeatureAnsatz):
        return [*ansatz.shapes, (ansatz.n_paths, (ansatz.count - ansatz.body) // ansatz.n_paths)]
    return [(ansatz.count,)]


@dataclass(eq=False)
class TrainedFit(Fit):
    """A fit with its training history; ``draws`` (n, n_parameters) are log-parameters if the method samples them."""

    attempt: FamilyAttempt | None = None
    draws: np.ndarray | None = None


def train(
    problem: Problem, guess: Guess, settings: FamilySettings, rng: np.random.Generator, path: TrainingPath, watch: Watch
) -> tuple[TrainedFit, float]:
    """Train from an initial guess; return the fit with its traces, and its work."""
    with torch_threads(settings.threads), torch.no_grad():
        attempt = FamilyAttempt(problem, guess, settings, rng, watch, path)
        attempt.record()
        attempt.train()
        attempt.record()
        fit = attempt.results()[0]
        fit.history = {**fit.history, **attempt.path_traces()}
        return TrainedFit(**vars(fit), attempt=attempt), attempt.loss.work


class TrainedPosterior:
    """Minus the log posterior at the end of a training, up to a constant: half the squared residual vector.

    Its deviations are those of ``weighting=noise`` at the last noise estimate and at ``slack``, for any weighting of
    the training. ``residuals``: the residual vector; ``z`` (1, n_z): the end of the training; ``n_weights``: number of
    coefficients, which precede the other unknowns in z.
    """

    def __init__(self, attempt: FamilyAttempt) -> None:
        self.attempt = attempt
        self.residuals = copy.copy(attempt.residuals)
        self.residuals.shift = None
        self.deviations = self.residuals.deviations(attempt.spread())
        self.z = attempt.walk.z.clone()
        self.n_weights = self.residuals.n_coefficients

    def unknowns(self, z: Tensor) -> tuple[np.ndarray, np.ndarray]:
        """Return all log-parameters (n_parameters,), and the channels' offsets, at z (1, n_z)."""
        _, logs, offsets = self.residuals.split(z)
        return plain(logs[0]), plain(offsets[0])

    def motion(self, z: Tensor) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Return displacements (n_dof, collocation) and initial states (2, n_dof) of each record."""
        outputs = self.residuals.evaluate(z, self.deviations).outputs
        records = [(plain(out[0])[..., : b.n_dof], b) for out, b in zip(outputs, self.residuals.blocks, strict=True)]
        return [out[0, : b.collocation].T for out, b in records], [out[:2, 0] for out, _ in records]

    def responses(self, z: Tensor) -> tuple[Function, ...]:
        """Return the response of each record as a function of time."""
        parts, _ = self.residuals.split_flat(z)
        return tuple(self.attempt._response(0, k, plain(part[0])) for k, part in enumerate(parts))

    def from_draws(self, fit: TrainedFit, draws: Sequence[Tensor], gradients: int) -> TrainedFit:
        """Return the fit with mean and covariance of log-parameters, and mean and spread of the response, of draws.

        Args:
            fit: The trained fit.
            draws: Draws of z, (1, n_z) each.
            gradients: Number of gradients that they required.
        """
        logs, offsets = (np.array(part) for part in zip(*map(self.unknowns, draws), strict=True))
        paths, starts = zip(*map(self.motion, draws), strict=True)
        spreads = [np.std(record, axis=0, ddof=1) for record in zip(*paths, strict=True)]
        few = [draws[i] for i in np.linspace(0, len(draws) - 1, min(CURVES, len(draws))).astype(int)]
        return replace(
            fit,
            logs=logs.mean(0),
            covariance=np.atleast_2d(np.cov(logs[:, self.residuals.free].T)),
            responses=tuple(map(AveragedResponse, zip(*map(self.responses, few), strict=True))),
            bands=tuple(Band(old.times, spread) for old, spread in zip(fit.bands, spreads, strict=True)),
            starts=[np.mean(record, axis=0) for record in zip(*starts, strict=True)],
            offsets=offsets.mean(0),
            evaluations=fit.evaluations + gradients,
        )


@dataclass(frozen=True, eq=False)
class AveragedResponse:
    """The mean of several responses."""

    responses: tuple[Function, ...]

    def __call__(self, times: np.ndarray) -> np.ndarray:
        """Evaluate the displacement, (n_dof, n_times), at times (n_times,)."""
        return np.asarray(np.mean([response(times) for response in self.responses], axis=0))
