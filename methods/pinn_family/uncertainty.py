"""The uncertainty of a trained fit in other ways than the engine's linearisation; NUTS has a file of its own.

Ensemble and bootstrap are the spread of further fits, as for the PINN. Every other way is a function of the posterior
at the end of the training, the fit and a random stream, and returns the fit as it states it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from scipy.optimize import least_squares
from torch import Tensor

from methods.network.ansatz import SumAnsatz
from methods.network.response import Band
from methods.pinn.engine import torch_threads
from methods.pinn.equations import equations
from methods.pinn.task import Fit
from methods.pinn_family import nuts
from methods.pinn_family.loss import plain, tensor
from methods.pinn_family.training import TrainedFit, TrainedPosterior

if TYPE_CHECKING:
    from methods.pinn_family.settings import FamilySettings

VARIATIONAL_STEPS, VARIATIONAL_RATE = 2000, 0.01
"""Adam's steps, and its first rate, of means in deviations and of deviations in their logarithms."""
VARIATIONAL_DRAWS = 200
"""Draws from the normal that the answer is made of."""
DROPOUT, DROPOUT_STEPS, DROPOUT_RATE = 0.05, 2000, 1e-3
"""Probability that a unit is silent; Adam's steps with masks, and its first rate."""
MASKS = 100
"""The least number of masks that the answer is made of."""


def stated(fit: Fit, settings: FamilySettings, rng: np.random.Generator) -> TrainedFit:
    """Return the fit with its uncertainty as the way of the settings states it."""
    assert isinstance(fit, TrainedFit)
    assert fit.attempt is not None
    with torch_threads(settings.threads), torch.no_grad():
        return WAYS[settings.uncertainty](TrainedPosterior(fit.attempt), fit, rng)


def last_layer(posterior: TrainedPosterior, fit: TrainedFit, rng: np.random.Generator) -> TrainedFit:
    """Linearise over output layer and parameters alone: the hidden layers stay where training left them.

    A. Kristiadi, M. Hein and P. Hennig, ICML 2020; E. Daxberger et al., NeurIPS 2021.
    """
    heads, short = posterior.residuals.heads(posterior.z)
    linear = equations(heads, heads.evaluate(short, posterior.deviations), posterior.deviations).posterior()
    n = len(posterior.residuals.free)
    pairs = zip(fit.bands, linear.deviations, strict=True)
    bands = [Band(old.times, sd[0].reshape(old.values.shape)) for old, sd in pairs]
    return replace(fit, covariance=plain(linear.covariance[0, :n, :n]), bands=tuple(bands))


def variational(posterior: TrainedPosterior, fit: TrainedFit, rng: np.random.Generator) -> TrainedFit:
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
    scale = (precision + nuts.LEAST_PRECISION * precision.max()).rsqrt()
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
    return replace(
        posterior.from_draws(fit, draws, VARIATIONAL_STEPS),
        logs=posterior.unknowns(centre)[0],
        covariance=np.diag(plain(sd[0, n : n + len(residuals.free)]) ** 2),
        responses=posterior.responses(centre),
    )


def dropout(posterior: TrainedPosterior, fit: TrainedFit, rng: np.random.Generator) -> TrainedFit:
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
    masked = [z.detach() * random_mask(posterior, rng) for _ in range(max(MASKS, posterior.attempt.family.members))]
    return posterior.from_draws(fit, [with_best_parameters(posterior, point) for point in masked], DROPOUT_STEPS)


def random_mask(posterior: TrainedPosterior, rng: np.random.Generator) -> Tensor:
    """Draw factors (1, n_z) of z that silence units; the others are ``1 / (1 - DROPOUT)`` times as large.

    Units are the functions that the output layer combines and that are no constant and no forced motion.
    """
    residuals, z = posterior.residuals, posterior.z
    short = []
    for ansatz, part in zip(residuals.ansatzes, residuals.split_flat(z)[0], strict=True):
        functions = ansatz.head(part)[0].dense().functions[0]
        n_forced = ansatz.fixed.functions.shape[-1] if isinstance(ansatz, SumAnsatz) else 0
        units = plain((functions[1] != 0).any(0))
        units[len(units) - n_forced :] = False
        mask = np.ones(len(units))
        mask[units] = (rng.random(units.sum()) >= DROPOUT) / (1.0 - DROPOUT)
        short.append(torch.as_tensor(np.tile(mask, residuals.blocks[0].n_paths), device=z.device)[None])
    rest = torch.ones_like(z[:, z.shape[1] - residuals.n_unknowns :])
    return residuals.with_heads(torch.ones_like(z), torch.cat([*short, rest], 1))


def with_best_parameters(posterior: TrainedPosterior, z: Tensor) -> Tensor:
    """Return z (1, n_z) with its parameters and offsets of least squared residuals, the response held."""
    residuals, deviations, n = posterior.residuals, posterior.deviations, posterior.n_weights

    def point(unknowns: np.ndarray) -> Tensor:
        return torch.cat([z[:, :n], tensor(unknowns, z)[None]], 1)

    def rows(unknowns: np.ndarray) -> np.ndarray:
        return plain(residuals.evaluate(point(unknowns), deviations).rows[0])

    def slopes(unknowns: np.ndarray) -> np.ndarray:
        state = residuals.evaluate(point(unknowns), deviations)
        return plain(residuals.linearise(state, deviations).columns[0])

    return point(least_squares(rows, plain(z[0, n:]), slopes, x_scale="jac", ftol=1e-6).x)


def _normal(rng: np.random.Generator, like: Tensor) -> Tensor:
    return torch.as_tensor(rng.standard_normal(tuple(like.shape)), device=like.device)


def _half_cosine(progress: float) -> float:
    return 0.5 * (1.0 + math.cos(math.pi * progress))


Way = Callable[[TrainedPosterior, TrainedFit, np.random.Generator], TrainedFit]
WAYS: Mapping[str, Way] = {
    "last_layer": last_layer,
    "variational": variational,
    "dropout": dropout,
    "nuts": nuts.stated,
}
