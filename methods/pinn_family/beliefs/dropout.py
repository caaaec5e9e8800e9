"""Monte-Carlo dropout: the spread over networks of which a random few hidden units are silent.

Y. Gal and Z. Ghahramani, ICML 2016; as for PINNs D. Zhang et al., J. Comput. Phys. 397:108850, 2019. The units are
those that the output layer combines, each silent with probability :data:`RATE`, the others ``1 / (1 - RATE)`` times as
large. Training goes on with a new mask at each step of Adam, at the weights of the rows that it ended with. Then, for
each mask of the answer, the response is the masked network's, and the parameters are those of least squared residuals
(equation of motion and prior) for that response.

A network whose output weights are large and cancel, as a second-order method leaves them, does not bear this: without
a unit its response is another.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from methods.pinn_family.beliefs.trained import Posterior, Said, TrainedFit, from_draws, hidden_units

RATE = 0.05
STEPS = 2000
LEARNING_RATE = 1e-3
MASKS = 100
"""The least number of masks that the answer is made of."""
INNER = 50
"""The most damped Gauss-Newton steps to the parameters of a masked response."""


class Masks:
    """Random masks of the vector z: what silences units of the last hidden layer of each record's network."""

    def __init__(self, posterior: Posterior, rng: np.random.Generator) -> None:
        self.posterior, self.rng = posterior, rng

    def draw(self) -> Tensor:
        """Factors (1, n_z) of z."""
        residuals, z = self.posterior.residuals, self.posterior.z
        parts, _ = residuals.split_flat(z)
        short = []
        for ansatz, part in zip(residuals.ansatzes, parts, strict=True):
            basis, coefficients = ansatz.head(part)
            units = hidden_units(ansatz)
            mask = np.ones(coefficients.shape[1] // basis.n_paths)
            mask[:units] = (self.rng.random(units) >= RATE) / (1.0 - RATE)
            short.append(torch.as_tensor(np.tile(mask, basis.n_paths), device=z.device)[None])
        rest = torch.ones_like(z[:, z.shape[1] - residuals.n_unknowns :])
        return residuals.with_heads(torch.ones_like(z), torch.cat([*short, rest], 1))


def stated(posterior: Posterior, fit: TrainedFit, rng: np.random.Generator, members: int) -> TrainedFit:
    """Mean and spread over masks, after training has gone on with them."""
    masks, residuals, deviations = Masks(posterior, rng), posterior.residuals, posterior.attempt.loss.deviations
    z = posterior.z.clone().requires_grad_(True)
    optimizer = torch.optim.Adam([z], lr=LEARNING_RATE)
    for step in range(STEPS):
        mask = masks.draw()
        _, gradient = residuals.gradient(z.detach() * mask, deviations)
        z.grad = gradient * mask / residuals.n_rows
        for group in optimizer.param_groups:
            group["lr"] = LEARNING_RATE * 0.5 * (1.0 + math.cos(math.pi * step / STEPS))
        optimizer.step()
    draws = [fitted(posterior, z.detach() * masks.draw()) for _ in range(max(MASKS, members))]
    return from_draws(posterior, fit, draws, Said(gradients=STEPS))


def fitted(posterior: Posterior, z: Tensor) -> Tensor:
    """z (1, n_z) with its parameters and offsets of least squared residuals, the response held."""
    residuals, n = posterior.residuals, posterior.n_weights
    damping, state = 1e-6, residuals.evaluate(z, posterior.deviations)
    for _ in range(INNER):
        columns = residuals.linearise(state, posterior.deviations).columns[0]
        matrix = columns.T @ columns
        matrix.diagonal().mul_(1.0 + damping).add_(1e-12)
        step = torch.linalg.solve(matrix, columns.T @ state.rows[0]).clamp(-2.0, 2.0)
        trial = state.z.clone()
        trial[0, n:] -= step
        after = residuals.evaluate(trial, posterior.deviations)
        promised = float(step @ (columns.T @ state.rows[0]))
        if after.loss[0] < state.loss[0]:
            state, damping = after, max(0.1 * damping, 1e-9)
        else:
            damping *= 10.0
        if promised < 1e-6 or damping > 1e8:
            break
    return state.z
