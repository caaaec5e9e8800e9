"""Uncertainty of a trained fit by methods besides the linearisation; NUTS is in another module.

Ensemble and bootstrap are the spread of further fits, as for the PINN. Every other method is a function of the
posterior at the end of the training, the fit and a random generator, and returns the fit with its uncertainty.
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
"""Steps and initial rate of Adam for scaled means and log standard deviations."""
VARIATIONAL_DRAWS = 200
"""Number of draws from the fitted normal distribution."""
DROPOUT, DROPOUT_STEPS, DROPOUT_RATE = 0.05, 2000, 1e-3
"""Dropout probability of a unit; steps and initial rate of Adam with masks."""
MASKS = 100
"""Least number of masks."""


def with_uncertainty(fit: Fit, settings: FamilySettings, rng: np.random.Generator) -> TrainedFit:
    """Return the fit with its uncertainty by the method of the settings."""
    assert isinstance(fit, TrainedFit)
    assert fit.attempt is not None
    with torch_threads(settings.threads), torch.no_grad():
        return METHODS[settings.uncertainty](TrainedPosterior(fit.attempt), fit, rng)


def last_layer(posterior: TrainedPosterior, fit: TrainedFit, rng: np.random.Generator) -> TrainedFit:
    """Linearise over output layer and parameters only, with fixed hidden layers.

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

    Means and deviations maximise the evidence lower bound by stochastic gradients of reparametrised draws (C. Blundell
    et al., ICML 2015), with a standard normal prior of the weights. The means start at the trained point, each
    deviation at that of its unknown with all others fixed, ``(JᵀJ + I)^(-1/2)`` on the diagonal, the optimum for a
    normal posterior (C. Bishop, Pattern Recognition and Machine Learning, 2006, section 10.1.2). Steps are scaled by
    the deviations, since the posterior's scales differ by many orders of magnitude.
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
        gradient[:, :n] += point[:, :n]  # gradient of the prior
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
    """Return the spread over networks with randomly omitted hidden units: Monte-Carlo dropout.

    Y. Gal and Z. Ghahramani, ICML 2016; for PINNs D. Zhang et al., J. Comput. Phys. 397:108850, 2019. The units are the
    inputs of the output layer. Training continues with a new mask at each step of Adam, with the final weights of the
    rows. For each mask, the response is that of the masked network, and the parameters minimise the residuals (equation
    of motion and prior) for that response. The method fails for networks with large, cancelling output weights, as
    second-order optimisers produce them, since omitting a unit changes their response completely.
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
    """Draw factors (1, n_z) of z that omit units and scale the others by ``1 / (1 - DROPOUT)``.

    Units are the inputs of the output layer except constants and forced motions.
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
    """Return z (1, n_z) with the parameters and offsets that minimise the residuals at a fixed response."""
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


Method = Callable[[TrainedPosterior, TrainedFit, np.random.Generator], TrainedFit]
METHODS: Mapping[str, Method] = {
    "last_layer": last_layer,
    "variational": variational,
    "dropout": dropout,
    "nuts": nuts.sample,
}
