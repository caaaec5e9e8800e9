"""Second-order optimisers: Gauss-Newton steps, Newton steps by conjugate gradients, and variable projection.

Gauss-Newton steps are solved in residual space, ``Jᵀ (J Jᵀ + μ)⁻¹ r`` (push-through, or Woodbury's, identity).
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.optimize import least_squares
from torch import Tensor

from methods.pinn.levenberg import GREATEST_DAMPING, LEAST_DAMPING, Walk, minimise
from methods.pinn_family.loss import COSTS, Loss, Optimizer, plain, tensor

FIRST_DAMPING = 1e-6
"""Initial damping of Levenberg-Marquardt, over the largest squared row of J."""
NATURAL_DAMPINGS = (1e-12, 1e-9, 1e-6)
"""Successive dampings of the natural gradient, over the largest squared row of J."""
LENGTHS = 0.5 ** np.arange(0.0, 31.0, 1.0)
"""Step lengths of the natural gradient's line search, as used by its authors."""
GAIN = 1e-6
"""Relative decrease of the loss below which the natural gradient increases its damping."""
RANK, REFRESH, CG_STEPS = 60, 20, 60
"""Rank of the preconditioner, steps between its updates, and largest number of CG iterations per step."""
CG_DAMPING = 1e-6
"""Damping of the Hessian, over its largest eigenvalue in the preconditioner."""
DIFFERENCE = 1e-5
"""Half step of the central difference of gradients."""
INNER = 20
"""Largest number of Levenberg-Marquardt steps for the output layer at given parameters."""


class LevenbergMarquardt(Optimizer):
    """Levenberg-Marquardt with Nielsen's damping (IMM-REP-1999-05)."""

    def minimise(self, loss: Loss, z: Tensor) -> Tensor:
        damping, growth = FIRST_DAMPING, 2.0
        while True:
            state, normal = loss.equations(z)
            value, size = float(state.loss[0]), float(normal.size[0])
            while True:
                step, decrease = normal.solve(torch.full((1,), damping * size, dtype=torch.float64))
                predicted = float(decrease[0])
                if predicted < loss.negligible(value):
                    return z
                after = loss.value(z - step[0])
                gain = (value - after) / predicted if predicted > 0 else -1.0
                if gain > 0:
                    break
                damping, growth = damping * growth, 2.0 * growth
                if damping > GREATEST_DAMPING:
                    return z
            z = z - step[0]
            damping = max(damping * max(0.1, 1.0 - (2.0 * gain - 1.0) ** 3), LEAST_DAMPING)
            growth = 2.0


class NaturalGradient(Optimizer):
    """Energy natural gradient: J. Müller and M. Zeinhofer, ICML 2023; by Woodbury's identity, arXiv:2505.12149, 2025.

    For a sum of squares this is a Gauss-Newton step at a fixed, small damping, with the best length of a grid.
    """

    def minimise(self, loss: Loss, z: Tensor) -> Tensor:
        for damping in NATURAL_DAMPINGS:
            least, value = -np.inf, np.inf
            while least < value * (1.0 - GAIN):
                state, normal = loss.equations(z)
                value = float(state.loss[0])
                step, decrease = normal.solve(normal.size * damping)
                length, least = 0.0, value
                if np.isfinite(float(decrease[0])):
                    length, least = _best_length(loss, z, step[0], value)
                z = z - length * step[0] if length else z
        return z


def _best_length(loss: Loss, z: Tensor, step: Tensor, value: float) -> tuple[float, float]:
    """Return the length of least loss on the grid, and that loss; zero where none is below ``value``."""
    best, least = 0.0, value
    for length in LENGTHS:
        trial = loss.value(z - length * step)
        if trial < least:
            best, least = length, trial
        elif best:
            break  # the minimum on the grid has been passed
    return best, least


class NystromNewtonCG(Optimizer):
    """Adam, then Newton steps by conjugate gradients with a randomised preconditioner, with Armijo's rule.

    P. Rathore, W. Lei, Z. Frangella, L. Lu and M. Udell, Challenges in Training PINNs, ICML 2024. The gradient
    is in closed form, so products with the Hessian are central differences of it.
    """

    adam_first = True

    def minimise(self, loss: Loss, z: Tensor) -> Tensor:
        loss.freeze()
        generator = torch.Generator().manual_seed(int(self.rng.integers(2**31)))
        value, gradient = loss.gradient(z)
        failures, steps = 0, 0
        while failures < 3:
            if steps % REFRESH == 0:
                vectors, values = _nystrom(loss, z, generator)
            direction = _conjugate_gradients(loss, z, gradient, vectors, values, CG_DAMPING * float(values[0]))
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
            steps += 1
        return z


def _hessian_product(loss: Loss, z: Tensor, vector: Tensor) -> Tensor:
    size = float(vector.norm())
    if size == 0.0:
        return torch.zeros_like(vector)
    ahead, behind = (loss.gradient(z + sign * DIFFERENCE / size * vector)[1] for sign in (1.0, -1.0))
    return (ahead - behind) * (size / (2.0 * DIFFERENCE))


def _nystrom(loss: Loss, z: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Return leading eigenvectors (n_z, rank) and eigenvalues of the Hessian by a randomised sketch, largest first."""
    sketch = torch.linalg.qr(torch.randn(z.shape[0], RANK, dtype=torch.float64, generator=generator))[0]
    image = torch.stack([_hessian_product(loss, z, column) for column in sketch.unbind(1)], 1)
    shift = np.finfo(float).eps ** 0.5 * float(image.norm())
    image = image + shift * sketch
    core = sketch.mT @ image
    values, axes = torch.linalg.eigh(0.5 * (core + core.mT))
    root = axes * values.clamp(min=1e-12 * float(values[-1])).rsqrt()
    vectors, sizes, _ = torch.linalg.svd(image @ root, full_matrices=False)
    return vectors, (sizes**2 - shift).clamp(min=0.0)


def _conjugate_gradients(
    loss: Loss, z: Tensor, gradient: Tensor, vectors: Tensor, values: Tensor, damping: float
) -> Tensor:
    """Return an approximate Newton direction, truncated at negative curvature."""

    def precondition(r: Tensor) -> Tensor:
        inside = vectors.mT @ r
        scaled = (values[-1] + damping) * (inside / (values + damping))
        return vectors @ scaled + (r - vectors @ inside)

    x, r = torch.zeros_like(z), -gradient
    y = precondition(r)
    p, size = y, float(r @ y)
    enough = min(0.1, float(gradient.norm()) ** 0.5) * float(gradient.norm())
    for _ in range(CG_STEPS):
        product = _hessian_product(loss, z, p) + damping * p
        curvature = float(p @ product)
        if curvature <= 0:
            break
        length = size / curvature
        x, r = x + length * p, r - length * product
        if float(r.norm()) <= enough:
            break
        y = precondition(r)
        size, before = float(r @ y), size
        p = y + size / before * p
    return x


class VariableProjection(Optimizer):
    """Variable projection on random features: hidden layers are fixed, the output layer is solved for.

    An extreme learning machine (G.-B. Huang et al., Neurocomputing 70:489, 2006; as a PINN V. Dwivedi and B.
    Srinivasan, Neurocomputing 391:96, 2020). For given physical parameters the output layer solves a least-squares
    problem; the remaining function of the parameters (G. Golub and V. Pereyra, SIAM J. Numer. Anal. 10:413, 1973) is
    minimised by SciPy's trust-region least squares.
    """

    def minimise(self, loss: Loss, z: Tensor) -> Tensor:
        loss.freeze()
        residuals, deviations = loss.residuals, loss.deviations
        heads, short = residuals.heads(z[None])
        free = slice(heads.n_coefficients, heads.n_coefficients + len(residuals.free))

        def projected(logs: np.ndarray) -> Tensor:
            """Solve for the output layer at given parameters."""
            point = short.clone()
            point[0, free] = tensor(logs, point)
            walk = Walk(point, 1e-9)
            minimise(heads.hold(), walk, deviations, INNER, 1e-9)
            loss.charge(COSTS["equations"] * float(walk.iterations[0]))
            return walk.z

        def rows(logs: np.ndarray) -> np.ndarray:
            point = projected(logs)
            state = heads.evaluate(point, deviations)
            loss.record(residuals.with_heads(z[None], point)[0], state)
            return plain(state.rows[0])

        search = least_squares(rows, plain(short[0, free]), ftol=1e-9, xtol=1e-10, diff_step=1e-6)
        return residuals.with_heads(z[None], projected(search.x))[0]
