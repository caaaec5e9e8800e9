"""Nyström-Newton-CG: second-order polishing with a randomised preconditioner.

P. Rathore, W. Lei, Z. Frangella, L. Lu and M. Udell, Challenges in Training PINNs, ICML 2024. DeepXDE ships it for
networks whose gradient torch records; the engine's gradient is in closed form, so products with the Hessian are central
differences of it here.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from methods.pinn_family.loss import Loss

RANK, REFRESH, CG_STEPS = 60, 20, 60
"""Rank of the preconditioner, steps from one to the next, and the most products with the Hessian in a step."""
DAMPING = 1e-6
"""Added to the Hessian, over its largest eigenvalue that the preconditioner finds."""
DIFFERENCE = 1e-5
"""Half the distance of the two gradients of a difference."""


def nystrom_newton_cg(loss: Loss, z: Tensor, seed: int) -> Tensor:
    """Newton steps by preconditioned conjugate gradients, with Armijo's rule, until none decreases the loss."""
    loss.freeze()
    generator = torch.Generator().manual_seed(seed)
    value, gradient = loss.gradient(z)
    failures = 0
    for step in range(10**7):
        if step % REFRESH == 0:
            vectors, values = _nystrom(loss, z, generator)
        direction = _conjugate_gradients(loss, z, gradient, vectors, values, DAMPING * float(values[0]))
        slope = float(gradient @ direction)
        if slope >= 0:
            direction, slope = -gradient, -float(gradient @ gradient)
        length = 1.0
        while not loss.value(z + length * direction) <= value + 0.1 * length * slope and length > 1e-10:
            length *= 0.5
        before = value
        if length > 1e-10:
            z = z + length * direction
            value, gradient = loss.gradient(z)
        failures = failures + 1 if before - value <= 1e-10 * max(value, 1e-300) else 0
        if failures >= 3:
            return z
    return z


def _product(loss: Loss, z: Tensor, vector: Tensor) -> Tensor:
    size = float(vector.norm())
    if size == 0.0:
        return torch.zeros_like(vector)
    ahead, behind = (loss.gradient(z + sign * DIFFERENCE / size * vector)[1] for sign in (1.0, -1.0))
    return (ahead - behind) * (size / (2.0 * DIFFERENCE))


def _nystrom(loss: Loss, z: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Leading eigenvectors (n_z, rank) and eigenvalues of the Hessian, largest first: a randomised sketch."""
    sketch = torch.linalg.qr(torch.randn(z.shape[0], RANK, dtype=torch.float64, generator=generator))[0]
    image = torch.stack([_product(loss, z, column) for column in sketch.unbind(1)], 1)
    shift = np.finfo(float).eps ** 0.5 * float(image.norm())
    image = image + shift * sketch
    core = sketch.mT @ image
    values, axes = torch.linalg.eigh(0.5 * (core + core.mT))
    root = axes * values.clamp(min=1e-12 * float(values[-1])).rsqrt()
    left, sizes, _ = torch.linalg.svd(image @ root, full_matrices=False)
    return left, (sizes**2 - shift).clamp(min=0.0)


def _conjugate_gradients(
    loss: Loss, z: Tensor, gradient: Tensor, vectors: Tensor, values: Tensor, damping: float
) -> Tensor:
    """An approximate Newton direction; stops at a direction of negative curvature."""

    def precondition(r: Tensor) -> Tensor:
        inside = vectors.mT @ r
        scaled = (values[-1] + damping) * (inside / (values + damping))
        return vectors @ scaled + (r - vectors @ inside)

    x, r = torch.zeros_like(z), -gradient
    y = precondition(r)
    p, size = y, float(r @ y)
    wanted = min(0.1, float(gradient.norm()) ** 0.5) * float(gradient.norm())
    for _ in range(CG_STEPS):
        product = _product(loss, z, p) + damping * p
        curvature = float(p @ product)
        if curvature <= 0:
            break
        length = size / curvature
        x, r = x + length * p, r - length * product
        if float(r.norm()) <= wanted:
            break
        y = precondition(r)
        size, before = float(r @ y), size
        p = y + size / before * p
    return x
