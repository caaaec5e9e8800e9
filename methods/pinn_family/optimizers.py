"""First-order and quasi-Newton optimisers, and the names of all; the others are in ``second_order``."""

from __future__ import annotations

import math
import warnings
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Literal

import numpy as np
import torch
from scipy.optimize import line_search, minimize
from torch import Tensor

from methods.pinn_family.loss import COSTS, Loss, Optimizer, plain, tensor
from methods.pinn_family.second_order import (
    LevenbergMarquardt,
    NaturalGradient,
    NystromNewtonCG,
    VariableProjection,
)

MEMORY = 50
"""Number of correction pairs of L-BFGS."""


class Descent(Optimizer):
    """Base of torch's optimisers, run until the work is used up, with a half-cosine schedule of the rate.

    The gradient is that of the mean over rows, to which the usual rates of these methods apply.
    """

    @abstractmethod
    def steppers(self, parts: Sequence[Tensor]) -> list[torch.optim.Optimizer]:
        """Return torch's optimisers of the parts of z."""

    def minimise(self, loss: Loss, z: Tensor) -> Tensor:
        sizes = [math.prod(shape) for shape in loss.shapes]
        pairs = zip(z.split(sizes), loss.shapes, strict=True)
        parts = [part.reshape(shape).clone().requires_grad_(True) for part, shape in pairs]
        steppers = self.steppers(parts)
        while True:
            _, gradient = loss.gradient(torch.cat([part.reshape(-1) for part in parts]).detach())
            gradient = gradient / loss.residuals.n_rows
            for part, slope in zip(parts, gradient.split(sizes), strict=True):
                part.grad = slope.reshape(part.shape).clone()
            for stepper in steppers:
                for group in stepper.param_groups:
                    group["lr"] = self.rate * max(0.5 * (1.0 + math.cos(math.pi * loss.progress)), 1e-3)
                stepper.step()


class Adam(Descent):
    """Adam: D. P. Kingma and J. Ba, ICLR 2015."""

    rate = 3e-3

    def steppers(self, parts: Sequence[Tensor]) -> list[torch.optim.Optimizer]:
        return [torch.optim.Adam(parts)]


class SOAP(Descent):
    """SOAP: N. Vyas et al., ICLR 2025; on PINNs S. Wang et al., arXiv:2502.00604."""

    rate = 3e-3

    def steppers(self, parts: Sequence[Tensor]) -> list[torch.optim.Optimizer]:
        import pytorch_optimizer

        return [pytorch_optimizer.SOAP(parts, weight_decay=0.0)]


class Muon(Descent):
    """Muon (K. Jordan et al., 2024) for weights between hidden layers, Adam for the rest, as its authors recommend."""

    rate = 1e-2

    def steppers(self, parts: Sequence[Tensor]) -> list[torch.optim.Optimizer]:
        matrices = [part for part in parts if part.ndim == 2 and min(part.shape) > 2]
        others = [part for part in parts if part.ndim != 2 or min(part.shape) <= 2]
        adam: list[torch.optim.Optimizer] = [torch.optim.Adam(others)]
        return [*adam, torch.optim.Muon(matrices, weight_decay=0.0)] if matrices else adam


class LBFGS(Optimizer):
    """L-BFGS with a Wolfe line search: SciPy's L-BFGS-B without bounds."""

    def minimise(self, loss: Loss, z: Tensor) -> Tensor:
        loss.freeze()

        def function(x: np.ndarray) -> tuple[float, np.ndarray]:
            value, gradient = loss.gradient(tensor(x, z))
            return value, plain(gradient)

        options = {"maxiter": 10**7, "maxfun": 10**7, "maxcor": MEMORY, "ftol": 1e-13, "gtol": 1e-10}
        return tensor(minimize(function, plain(z), jac=True, method="L-BFGS-B", options=options).x, z)


class AdamLBFGS(LBFGS):
    """Adam, then L-BFGS, as in the paper."""

    adam_first = True


class SelfScaledBFGS(Optimizer):
    """Self-scaled BFGS or Broyden: J. F. Urbán, P. Stefanou and J. A. Pons, J. Comput. Phys. 523:113656, 2025.

    The inverse Hessian approximation H is dense. With step s, change of gradient y, ``b = -α sᵀg / yᵀs`` and
    ``h = yᵀH y / yᵀs``, their equations give the scaling τ and the parameter φ of Broyden's family
    (M. Al-Baali, SIAM J. Optim. 1998, for the latter), and
    ``H+ = (H - H y yᵀH / yᵀH y + φ yᵀH y v vᵀ) / τ + s sᵀ / yᵀs`` with ``v = s / yᵀs - H y / yᵀH y``.
    """

    family: Literal["bfgs", "broyden"] = "bfgs"

    def minimise(self, loss: Loss, z: Tensor) -> Tensor:
        loss.freeze()
        value, gradient = loss.gradient(z)
        inverse, fresh, before = _scaled_identity(gradient), True, None
        while True:
            direction = -(inverse @ gradient)
            loss.charge(COSTS["matrix"] * z.shape[0] ** 2 * 0.5)
            step = _line_search(loss, z, value, gradient, direction, before)
            if step is None:
                if fresh:
                    return z
                inverse, fresh, before = _scaled_identity(gradient), True, None
                continue
            fresh = False
            length, after, new_gradient = step
            s, y = length * direction, new_gradient - gradient
            ys = float(y @ s)
            if ys > 1e-300:
                inverse = self._updated(inverse, s, y, ys, length * float(-(s @ gradient)))
                loss.charge(COSTS["matrix"] * z.shape[0] ** 2)
            converged = abs(value - after) <= 1e-13 * max(abs(value), abs(after), 1e-300)
            before, value, z, gradient = value, after, z + s, new_gradient
            if converged:
                return z

    def _updated(self, inverse: Tensor, s: Tensor, y: Tensor, ys: float, sBs: float) -> Tensor:
        """Return H after a step. ``sBs`` is ``sᵀB s`` with B the inverse of H."""
        hy = inverse @ y
        yhy = float(y @ hy)
        b, h = sBs / ys, yhy / ys
        a = max(b * h - 1.0, 1e-16)
        theta = 0.0
        if self.family == "broyden":
            least = min(1.0, h * (1.0 - np.sqrt(a / (1.0 + a))))
            theta = max((least - 1.0) / a, min(1.0 / max(least, 1e-300), (1.0 - b) / b))
        sigma = 1.0 + a * theta
        power = abs(sigma) ** (1.0 / (1.0 - s.shape[0]))
        rho = min(1.0, 1.0 / b)
        tau = rho * min(power, 1.0 / theta) if theta > 0 else min(rho * power, sigma)
        phi = (1.0 - theta) / sigma
        v = s / ys - hy / yhy
        inverse.addr_(hy, hy, alpha=-1.0 / yhy).addr_(v, v, alpha=phi * yhy).mul_(1.0 / tau).addr_(s, s, alpha=1.0 / ys)
        return inverse


class SelfScaledBroyden(SelfScaledBFGS):
    """The member of Broyden's family recommended by the same authors."""

    family = "broyden"


def _scaled_identity(gradient: Tensor) -> Tensor:
    return torch.diag(torch.full_like(gradient, 1.0 / max(float(gradient.norm()), 1.0)))


def _line_search(
    loss: Loss, z: Tensor, value: float, gradient: Tensor, direction: Tensor, before: float | None
) -> tuple[float, float, Tensor] | None:
    """Return a step length for the strong Wolfe conditions (SciPy's), loss and gradient there; None without one."""

    @lru_cache(maxsize=1)  # SciPy evaluates value and slope of a point separately
    def evaluate_bytes(point: bytes) -> tuple[float, Tensor]:
        return loss.gradient(tensor(np.frombuffer(point).copy(), z))

    def evaluate(x: np.ndarray) -> tuple[float, Tensor]:
        return evaluate_bytes(x.tobytes())

    vectors = (plain(z), plain(direction), plain(gradient))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        length, _, _, after, _, slope = line_search(
            lambda x: evaluate(x)[0], lambda x: plain(evaluate(x)[1]), *vectors, value, before
        )
    if length is None or slope is None or not np.isfinite(after):
        return None
    return float(length), float(after), evaluate(plain(z) + length * plain(direction))[1]


COMPONENTS: Mapping[str, type[Optimizer]] = {
    "adam": Adam,
    "adam_lbfgs": AdamLBFGS,
    "lbfgs": LBFGS,
    "soap": SOAP,
    "muon": Muon,
    "self_scaled_bfgs": SelfScaledBFGS,
    "self_scaled_broyden": SelfScaledBroyden,
    "nystrom_newton_cg": NystromNewtonCG,
    "natural_gradient": NaturalGradient,
    "variable_projection": VariableProjection,
    "lm": LevenbergMarquardt,
}
