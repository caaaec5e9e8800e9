"""Mean-field variational inference: an independent normal for each weight and each parameter.

Its mean and deviations maximise the evidence lower bound by stochastic gradients of reparametrised draws (C. Blundell
et al., ICML 2015), with a standard normal prior of the weights. The mean starts at the trained point, each deviation at
that of its unknown with all others fixed, ``(JᵀJ + I)^(-1/2)`` on the diagonal, which is the optimum where the
posterior is a normal (C. Bishop, Pattern Recognition and Machine Learning, 2006, section 10.1.2). Steps are counted in
deviations, for the posterior's axes differ in length by many orders of ten.
"""

from __future__ import annotations

import math

import numpy as np
import torch

from methods.pinn_family.beliefs.trained import Posterior, Said, TrainedFit, from_draws, normal

STEPS = 2000
RATE = 0.01
"""Adam's first rate, of means in deviations and of deviations in their logarithms; it falls along a half cosine."""
DRAWS = 200
"""Draws from the normal that the answer is made of."""
LEAST = 1e-12
"""Precision of an unknown that neither data nor prior tell of."""


def stated(posterior: Posterior, fit: TrainedFit, rng: np.random.Generator, members: int) -> TrainedFit:
    """The normal of independent unknowns that is nearest to the posterior, from below."""
    residuals, deviations, z, n = posterior.residuals, posterior.deviations, posterior.z, posterior.n_weights
    first = squares(posterior)
    first[:, :n] += 1.0
    scale = (first + LEAST * first.max()).rsqrt()
    mean, log_sd = torch.zeros_like(z, requires_grad=True), torch.zeros_like(z, requires_grad=True)
    optimizer = torch.optim.Adam([mean, log_sd], lr=RATE)
    for step in range(STEPS):
        noise = normal(rng, tuple(z.shape), z)
        own = scale * log_sd.detach().exp() * noise
        at = z + scale * mean.detach() + own
        _, gradient = residuals.gradient(at, deviations)
        gradient[:, :n] += at[:, :n]  # the prior's
        mean.grad = scale * gradient
        log_sd.grad = own * gradient - 1.0
        for group in optimizer.param_groups:
            group["lr"] = RATE * 0.5 * (1.0 + math.cos(math.pi * step / STEPS))
        optimizer.step()
    centre, sd = z + scale * mean.detach(), scale * log_sd.detach().exp()
    draws = [centre + sd * normal(rng, tuple(z.shape), z) for _ in range(DRAWS)]
    found = from_draws(posterior, fit, draws, Said(gradients=STEPS))
    free = residuals.free
    found.logs = posterior.parameters(centre)
    found.covariance = np.diag(np.asarray(sd[0, n : n + len(free)].cpu()) ** 2)
    found.responses = tuple(posterior.responses(centre))
    return found


def squares(posterior: Posterior) -> torch.Tensor:
    """Sums of squares of the columns of J at the trained point, (1, n_z)."""
    residuals, deviations = posterior.residuals, posterior.deviations
    state = residuals.evaluate(posterior.z, deviations)
    linear = residuals.linearise(state, deviations)
    return sum((part**2).sum(1) for _, part in residuals.jacobian_parts(state, linear))  # type: ignore[return-value]
