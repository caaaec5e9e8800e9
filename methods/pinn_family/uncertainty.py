"""The uncertainty of a trained fit in other ways than the engine's linearisation; NUTS has a file of its own.

Ensemble and bootstrap are the spread of further fits. Every other way is a function of the posterior at the end of the
training, the fit, a random stream and the number of ``members``, and returns the fit as it states it.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from scipy.optimize import least_squares
from torch import Tensor

from methods.network.ansatz import Ansatz, SumAnsatz
from methods.network.response import Band, Function
from methods.network.tanh import Network
from methods.pinn.engine import torch_threads
from methods.pinn.equations import equations
from methods.pinn.task import Fit, Task, simulated
from methods.pinn_family.architectures import FeatureAnsatz
from methods.pinn_family.loss import Clock, TrainingPath, tensor
from methods.pinn_family.sampling import TrainingResiduals
from methods.pinn_family.training import FamilyAttempt, TrainedFit, fit

if TYPE_CHECKING:
    from methods.pinn_family.settings import FamilySettings

CURVES = 50
"""The most responses that are averaged in a reconstruction."""
LEAST_PRECISION = 1e-12
"""Precision, over the largest, of an unknown that neither data nor prior determine."""
VARIATIONAL_STEPS, VARIATIONAL_RATE = 2000, 0.01
"""Adam's steps, and its first rate, of means in deviations and of deviations in their logarithms."""
VARIATIONAL_DRAWS = 200
"""Draws from the normal that the answer is made of."""
DROPOUT, DROPOUT_STEPS, DROPOUT_RATE = 0.05, 2000, 1e-3
"""Probability that a unit is silent; Adam's steps with masks, and its first rate."""
MASKS = 100
"""The least number of masks that the answer is made of."""


class TrainedPosterior:
    """Minus the log posterior at the end of a training, up to a constant: half the squared residual vector.

    Its deviations are those of ``weighting=noise`` at the noise estimated last, the physics as hard as ``slack`` says,
    whatever the weights that the training had. ``residuals`` is the vector, ``z`` (1, n_z) where the training ended,
    ``n_weights`` the number of coefficients, which stand before the other unknowns.
    """

    def __init__(self, attempt: FamilyAttempt) -> None:
        self.attempt = attempt
        self.residuals = copy.copy(attempt.residuals)
        if isinstance(self.residuals, TrainingResiduals):
            self.residuals.shift = None
        self.deviations = self.residuals.deviations(attempt.spread())
        self.z = attempt.walk.z.clone()
        self.n_weights = self.residuals.n_coefficients

    def parameters(self, z: Tensor) -> np.ndarray:
        """Return all log-parameters (n_parameters,) at z (1, n_z)."""
        return np.asarray(self.residuals.split(z)[1][0].cpu())

    def offsets(self, z: Tensor) -> np.ndarray:
        """Return the channels' offsets at z (1, n_z)."""
        return np.asarray(self.residuals.split(z)[2][0].cpu())

    def motion(self, z: Tensor) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Return displacements (n_dof, collocation) and initial states (2, n_dof), record by record."""
        blocks, outputs = self.residuals.blocks, self.residuals.evaluate(z, self.deviations).outputs
        records = [(np.asarray(out[0].cpu()), b) for out, b in zip(outputs, blocks, strict=True)]
        paths = [out[0, : b.collocation, : b.n_dof].T for out, b in records]
        return paths, [out[:2, 0, : b.n_dof] for out, b in records]

    def responses(self, z: Tensor) -> list[Function]:
        """Return the response by time, record by record."""
        parts, _ = self.residuals.split_flat(z)
        return [self.attempt._response(0, k, np.asarray(part[0].cpu())) for k, part in enumerate(parts)]


@dataclass(frozen=True, eq=False)
class AveragedResponse:
    """The mean of responses; can be pickled where they can."""

    responses: tuple[Function, ...]

    def __call__(self, times: np.ndarray) -> np.ndarray:
        """Return the displacement, shape (n_dof, n_times), at times of shape (n_times,)."""
        return np.asarray(np.mean([response(times) for response in self.responses], axis=0))


def from_draws(posterior: TrainedPosterior, fit: TrainedFit, draws: Sequence[Tensor], gradients: int) -> TrainedFit:
    """Return the fit as draws of z (1, n_z) state it, which took so many gradients.

    They give mean and covariance of the log-parameters, and mean and spread of the response.
    """
    logs = np.array([posterior.parameters(z) for z in draws])
    few = [draws[i] for i in np.linspace(0, len(draws) - 1, min(CURVES, len(draws))).astype(int)]
    paths, starts = zip(*(posterior.motion(z) for z in draws), strict=True)
    spreads = [np.std(record, axis=0, ddof=1) for record in zip(*paths, strict=True)]
    return replace(
        fit,
        logs=logs.mean(0),
        covariance=np.atleast_2d(np.cov(logs[:, posterior.residuals.free].T)),
        responses=tuple(map(AveragedResponse, zip(*map(posterior.responses, few), strict=True))),
        bands=tuple(Band(old.times, spread) for old, spread in zip(fit.bands, spreads, strict=True)),
        starts=[np.mean(record, axis=0) for record in zip(*starts, strict=True)],
        offsets=np.mean([posterior.offsets(z) for z in draws], axis=0),
        evaluations=fit.evaluations + gradients,
    )


def stated(way: Way, fit: TrainedFit, settings: FamilySettings, rng: np.random.Generator) -> TrainedFit:
    """Return the fit with its uncertainty as a way states it."""
    assert fit.attempt is not None
    with torch_threads(settings.threads), torch.no_grad():
        return way(TrainedPosterior(fit.attempt), fit, rng, settings.members)


def members(task: Task, best: Fit, settings: FamilySettings) -> list[Fit]:
    """Return fits from the guess of the best, each with its own first weights and the whole budget.

    They are of the same data (ensemble), or of simulated records (bootstrap).
    """
    guess = task.guesses[task.fits.index(best)]
    bootstrap = settings.uncertainty == "bootstrap"
    problems = [simulated(task.scaled, best, task.rng) if bootstrap else task.scaled for _ in range(settings.members)]
    fits: list[Fit] = []
    for problem, rng in zip(problems, task.rng.spawn(settings.members), strict=True):
        member, _ = fit(problem, guess, settings, rng, TrainingPath(Clock()), lambda results: None)
        member.attempt = None
        if np.all(np.isfinite(member.logs)):
            fits.append(member)
    return fits


def last_layer(posterior: TrainedPosterior, fit: TrainedFit, rng: np.random.Generator, members: int) -> TrainedFit:
    """Linearise over output layer and parameters alone: the hidden layers stay where training left them.

    A. Kristiadi, M. Hein and P. Hennig, ICML 2020; E. Daxberger et al., NeurIPS 2021.
    """
    heads, short = posterior.residuals.heads(posterior.z)
    linear = equations(heads, heads.evaluate(short, posterior.deviations), posterior.deviations).posterior()
    n = len(posterior.residuals.free)
    pairs = zip(fit.bands, linear.deviations, strict=True)
    bands = [Band(old.times, sd[0].reshape(old.values.shape)) for old, sd in pairs]
    return replace(fit, covariance=np.asarray(linear.covariance[0, :n, :n].cpu()), bands=tuple(bands))


def variational(posterior: TrainedPosterior, fit: TrainedFit, rng: np.random.Generator, members: int) -> TrainedFit:
    """Fit an independent normal for each weight and each parameter: mean-field variational inference.

    Its mean and deviations maximise the evidence lower bound by stochastic gradients of reparametrised draws (C.
    Blundell et al., ICML 2015), with a standard normal prior of the weights. The mean starts at the trained point, each
    deviation at that of its unknown with all others fixed, ``(JᵀJ + I)^(-1/2)`` on the diagonal, which is the optimum
    where the posterior is a normal (C. Bishop, Pattern Recognition and Machine Learning, 2006, section 10.1.2). Steps
    are counted in deviations, for the posterior's axes differ in length by many orders of ten.
    """
    residuals, deviations, z, n = posterior.residuals, posterior.deviations, posterior.z, posterior.n_weights
    linear = residuals.linearise(state := residuals.evaluate(z, deviations), deviations)
    precision = torch.stack([(part**2).sum(1) for _, part in residuals.jacobian_parts(state, linear)]).sum(0)
    precision[:, :n] += 1.0
    scale = (precision + LEAST_PRECISION * precision.max()).rsqrt()
    mean, log_sd = torch.zeros_like(z, requires_grad=True), torch.zeros_like(z, requires_grad=True)
    optimizer = torch.optim.Adam([mean, log_sd], lr=VARIATIONAL_RATE)
    for step in range(VARIATIONAL_STEPS):
        deviation = scale * log_sd.detach().exp() * _normal(rng, z)
        point = z + scale * mean.detach() + deviation
        _, gradient = residuals.gradient(point, deviations)
        gradient[:, :n] += point[:, :n]  # the prior's
        mean.grad, log_sd.grad = scale * gradient, deviation * gradient - 1.0
        optimizer.param_groups[0]["lr"] = VARIATIONAL_RATE * _half_cosine(step / VARIATIONAL_STEPS)
        optimizer.step()
    centre, sd = z + scale * mean.detach(), scale * log_sd.detach().exp()
    draws = [centre + sd * _normal(rng, z) for _ in range(VARIATIONAL_DRAWS)]
    answer = from_draws(posterior, fit, draws, VARIATIONAL_STEPS)
    answer.logs = posterior.parameters(centre)
    answer.covariance = np.diag(np.asarray(sd[0, n : n + len(residuals.free)].cpu()) ** 2)
    answer.responses = tuple(posterior.responses(centre))
    return answer


def dropout(posterior: TrainedPosterior, fit: TrainedFit, rng: np.random.Generator, members: int) -> TrainedFit:
    """State the spread over networks of which a random few hidden units are silent: Monte-Carlo dropout.

    Y. Gal and Z. Ghahramani, ICML 2016; as for PINNs D. Zhang et al., J. Comput. Phys. 397:108850, 2019. The units are
    those that the output layer combines. Training goes on with a new mask at each step of Adam, at the weights of the
    rows that it ended with. Then, for each mask of the answer, the response is the masked network's, and the parameters
    are those of least squared residuals (equation of motion and prior) for that response. A network whose output
    weights are large and cancel, as a second-order method leaves them, does not bear this: without a unit its response
    is another.
    """
    residuals, deviations = posterior.residuals, posterior.attempt.loss.deviations
    z = posterior.z.clone().requires_grad_(True)
    optimizer = torch.optim.Adam([z], lr=DROPOUT_RATE)
    for step in range(DROPOUT_STEPS):
        mask = random_mask(posterior, rng)
        z.grad = residuals.gradient(z.detach() * mask, deviations)[1] * mask / residuals.n_rows
        optimizer.param_groups[0]["lr"] = DROPOUT_RATE * _half_cosine(step / DROPOUT_STEPS)
        optimizer.step()
    masked = [z.detach() * random_mask(posterior, rng) for _ in range(max(MASKS, members))]
    return from_draws(posterior, fit, [with_best_parameters(posterior, point) for point in masked], DROPOUT_STEPS)


def random_mask(posterior: TrainedPosterior, rng: np.random.Generator) -> Tensor:
    """Draw factors (1, n_z) of z that silence units; the others are ``1 / (1 - DROPOUT)`` times as large."""
    residuals, z = posterior.residuals, posterior.z
    short = []
    for ansatz, part in zip(residuals.ansatzes, residuals.split_flat(z)[0], strict=True):
        basis, coefficients = ansatz.head(part)
        units = hidden_units(ansatz)
        mask = np.ones(coefficients.shape[1] // basis.n_paths)
        mask[:units] = (rng.random(units) >= DROPOUT) / (1.0 - DROPOUT)
        short.append(torch.as_tensor(np.tile(mask, basis.n_paths), device=z.device)[None])
    rest = torch.ones_like(z[:, z.shape[1] - residuals.n_unknowns :])
    return residuals.with_heads(torch.ones_like(z), torch.cat([*short, rest], 1))


def with_best_parameters(posterior: TrainedPosterior, z: Tensor) -> Tensor:
    """Return z (1, n_z) with its parameters and offsets of least squared residuals, the response held."""
    residuals, deviations, n = posterior.residuals, posterior.deviations, posterior.n_weights

    def point(unknowns: np.ndarray) -> Tensor:
        return torch.cat([z[:, :n], tensor(unknowns, z)[None]], 1)

    def rows(unknowns: np.ndarray) -> np.ndarray:
        return np.asarray(residuals.evaluate(point(unknowns), deviations).rows[0].cpu())

    def slopes(unknowns: np.ndarray) -> np.ndarray:
        state = residuals.evaluate(point(unknowns), deviations)
        return np.asarray(residuals.linearise(state, deviations).columns[0].cpu())

    return point(least_squares(rows, np.asarray(z[0, n:].cpu()), slopes, x_scale="jac", ftol=1e-6).x)


def hidden_units(ansatz: Ansatz) -> int:
    """Count the functions that the output layer combines and that are no constant and no forced motion."""
    if isinstance(ansatz, SumAnsatz):
        return hidden_units(ansatz.inner)
    if isinstance(ansatz, Network):
        return ansatz.widths[-2]
    if isinstance(ansatz, FeatureAnsatz):
        return ansatz.features.n_features()
    return ansatz.count // getattr(ansatz, "n_paths", 1)


def _normal(rng: np.random.Generator, like: Tensor) -> Tensor:
    return torch.as_tensor(rng.standard_normal(tuple(like.shape)), device=like.device)


def _half_cosine(progress: float) -> float:
    return 0.5 * (1.0 + math.cos(math.pi * progress))


Way = Callable[[TrainedPosterior, TrainedFit, np.random.Generator, int], TrainedFit]
WAYS: Mapping[str, Way] = {"last_layer": last_layer, "variational": variational, "dropout": dropout}
