"""Quasi-Newton training: L-BFGS, and the self-scaled BFGS and Broyden methods with a dense matrix."""

from __future__ import annotations

import warnings
from typing import Literal

import numpy as np
import torch
from scipy.optimize import line_search, minimize
from torch import Tensor

from methods.pinn_family.loss import COSTS, Loss, plain, tensor

MEMORY = 50
"""Pairs that L-BFGS remembers."""


def lbfgs(loss: Loss, z: Tensor) -> Tensor:
    """L-BFGS with a line search for the Wolfe conditions: scipy's L-BFGS-B without bounds."""
    loss.freeze()

    def function(x: np.ndarray) -> tuple[float, np.ndarray]:
        value, gradient = loss.gradient(tensor(x, z))
        return value, plain(gradient)

    options = {"maxiter": 10**7, "maxfun": 10**7, "maxcor": MEMORY, "ftol": 1e-13, "gtol": 1e-10}
    return tensor(minimize(function, plain(z), jac=True, method="L-BFGS-B", options=options).x, z)


def self_scaled(loss: Loss, z: Tensor, family: Literal["bfgs", "broyden"]) -> Tensor:
    """Self-scaled BFGS or Broyden: J. F. Urbán, P. Stefanou and J. A. Pons, J. Comput. Phys. 523:113656, 2025.

    The inverse Hessian approximation H is dense. With step s, change of gradient y, ``b = -α sᵀg / yᵀs`` and
    ``h = yᵀH y / yᵀs``, their equations give the scaling τ and the member φ of Broyden's family
    (M. Al-Baali, SIAM J. Optim. 1998, for the latter), and
    ``H+ = (H - H y yᵀH / yᵀH y + φ yᵀH y v vᵀ) / τ + s sᵀ / yᵀs`` with ``v = s / yᵀs - H y / yᵀH y``.
    """
    loss.freeze()
    value, gradient = loss.gradient(z)
    inverse = torch.eye(z.shape[0], dtype=torch.float64, device=z.device)
    inverse /= max(float(gradient.norm()), 1.0)
    before: float | None = None
    fresh = True
    while True:
        direction = -(inverse @ gradient)
        loss.charge(COSTS["matrix"] * z.shape[0] ** 2 * 0.5)
        found = _line_search(loss, z, value, gradient, direction, before)
        if found is None:
            if fresh:
                return z
            inverse = torch.eye(z.shape[0], dtype=torch.float64, device=z.device) / max(float(gradient.norm()), 1.0)
            fresh, before = True, None
            continue
        fresh = False
        length, after, new_gradient = found
        s, y = length * direction, new_gradient - gradient
        ys = float(y @ s)
        if ys > 1e-300:
            inverse = _updated(inverse, s, y, ys, length * float(-(s @ gradient)), family)
            loss.charge(COSTS["matrix"] * z.shape[0] ** 2)
        settled = abs(value - after) <= 1e-13 * max(abs(value), abs(after), 1e-300)
        before, value, z, gradient = value, after, z + s, new_gradient
        if settled:
            return z


def _line_search(
    loss: Loss, z: Tensor, value: float, gradient: Tensor, direction: Tensor, before: float | None
) -> tuple[float, float, Tensor] | None:
    """A length for the strong Wolfe conditions (scipy's), the loss and the gradient there; None where there is none."""
    last: dict[bytes, tuple[float, Tensor]] = {}

    def both(x: np.ndarray) -> tuple[float, Tensor]:
        key = x.tobytes()
        if key not in last:
            last.clear()
            last[key] = loss.gradient(tensor(x, z))
        return last[key]

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        length, _, _, after, _, slope = line_search(
            lambda x: both(x)[0],
            lambda x: plain(both(x)[1]),
            plain(z),
            plain(direction),
            plain(gradient),
            value,
            before,
        )
    if length is None or slope is None or not np.isfinite(after):
        return None
    return float(length), float(after), both(plain(z) + length * plain(direction))[1]


def _updated(inverse: Tensor, s: Tensor, y: Tensor, ys: float, sBs: float, family: str) -> Tensor:
    """H after a step; see :func:`self_scaled`. ``sBs`` is ``sᵀB s`` with B the inverse of H."""
    hy = inverse @ y
    yhy = float(y @ hy)
    b, h = sBs / ys, yhy / ys
    a = max(b * h - 1.0, 1e-16)
    theta = 0.0
    if family == "broyden":
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
