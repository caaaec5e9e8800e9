"""Gauss-Newton training: Levenberg-Marquardt as the engine has it, and energy natural gradients.

Both solve the same equations in residual space, ``Jᵀ (J Jᵀ + μ)⁻¹ r`` (push-through, or Woodbury's, identity). They
differ in what they do with the solution: Levenberg-Marquardt takes the whole step and adapts μ; natural gradients keep
μ and search along the line.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from methods.pinn.levenberg import GREATEST_DAMPING, LEAST_DAMPING
from methods.pinn_family.loss import Loss

FIRST_DAMPING = 1e-6
"""Damping at the start, over the largest squared row of J."""
NATURAL_DAMPINGS = (1e-12, 1e-9, 1e-6)
"""The natural gradient's, likewise, one after the other."""
LENGTHS = 0.5 ** np.arange(0.0, 31.0, 1.0)
"""Lengths that the natural gradient's line search tries, as its authors do: powers of a half down to 2^-30."""


def levenberg_marquardt(loss: Loss, z: Tensor, absolute: float = 0.0, relative: float = 0.0) -> Tensor:
    """Levenberg-Marquardt with Nielsen's damping (IMM-REP-1999-05).

    It ends where the linear model promises less than ``absolute``, or ``relative`` times the loss.
    """
    damping, growth = FIRST_DAMPING, 2.0
    while True:
        state, normal = loss.equations(z)
        value, size = float(state.loss[0]), float(normal.size[0])
        while True:
            step, promise = normal.solve(torch.full((1,), damping * size, dtype=torch.float64))
            promised = float(promise[0])
            if promised < max(absolute, relative * value, 1e-300):
                return z
            after = loss.value(z - step[0])
            gain = (value - after) / promised if promised > 0 else -1.0
            if gain > 0:
                break
            damping, growth = damping * growth, 2.0 * growth
            if damping > GREATEST_DAMPING:
                return z
        z = z - step[0]
        damping = max(damping * max(0.1, 1.0 - (2.0 * gain - 1.0) ** 3), LEAST_DAMPING)
        growth = 2.0


def natural_gradient(loss: Loss, z: Tensor, tolerance: float) -> Tensor:
    """Energy natural gradient: J. Müller and M. Zeinhofer, ICML 2023; by Woodbury's identity, arXiv:2505.12149, 2025.

    For a sum of squares its metric is the Gauss-Newton matrix, so the direction is that of Levenberg-Marquardt at a
    fixed, small damping; the length is the best of a grid. Where no length gains ``tolerance`` of the loss, the damping
    is raised a thousandfold, twice at most.
    """
    dampings = iter(NATURAL_DAMPINGS)
    damping = next(dampings)
    while True:
        state, normal = loss.equations(z)
        value = float(state.loss[0])
        step, promise = normal.solve(normal.size * damping)
        length, least = 0.0, value
        if np.isfinite(float(promise[0])):
            length, least = _best_length(loss, z, step[0], value)
        z = z - length * step[0] if length else z
        if not least < value * (1.0 - tolerance):
            more = next(dampings, None)
            if more is None:
                return z
            damping = more


def _best_length(loss: Loss, z: Tensor, step: Tensor, value: float) -> tuple[float, float]:
    """The length of the grid with the least loss, and that loss; zero where none is below ``value``."""
    best, least = 0.0, value
    for length in LENGTHS:
        found = loss.value(z - length * step)
        if found < least:
            best, least = length, found
        elif best:
            break  # the best of the grid is behind
    return best, least
