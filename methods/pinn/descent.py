"""The paper's training by Adam and then L-BFGS; the loss is half the squared norm of the residual vector."""

from __future__ import annotations

import numpy as np
import torch
from scipy.optimize import minimize
from torch import Tensor

from methods.pinn.levenberg import Walk
from methods.pinn.residuals import Residuals, State

EVERY = 10
"""Steps between two entries of the history."""
MEMORY = 30
"""Number of correction pairs of L-BFGS."""


def adam(residuals: Residuals, walk: Walk, deviations: Tensor, steps: int, rate: float) -> None:
    """Run Adam (Kingma and Ba, 2015) with default moments on the mean of the squared rows."""
    optimizer = torch.optim.Adam([walk.z], rate)
    everyone = np.arange(residuals.n_fits)
    for i in range(1, steps + 1):
        state, gradient = residuals.gradient(walk.z, deviations)
        if i % EVERY == 0:
            walk.record(everyone, state.rows * deviations)
        walk.z.grad = gradient / residuals.n_rows
        optimizer.step()
        walk.evaluations += 1
        walk.iterations += 1
    walk.z.grad = None


def lbfgs(residuals: Residuals, walk: Walk, deviations: Tensor, steps: int) -> None:
    """Run L-BFGS with a Wolfe line search (SciPy's L-BFGS-B without bounds) for each fit in turn."""
    for i in range(residuals.n_fits):
        _lbfgs(residuals.take(np.array([i])), walk, i, deviations[i : i + 1], steps)


def _lbfgs(residuals: Residuals, walk: Walk, i: int, deviations: Tensor, steps: int) -> None:
    last: list[State] = []
    who = np.array([i])

    def loss(z: np.ndarray) -> tuple[float, np.ndarray]:
        state, gradient = residuals.gradient(torch.as_tensor(z[None], device=residuals.device), deviations)
        last[:] = [state]
        walk.evaluations[i] += 1
        return float(state.loss[0]), gradient[0].cpu().numpy()

    def count(_: np.ndarray) -> None:
        walk.iterations[i] += 1
        if walk.iterations[i] % EVERY == 0:
            walk.record(who, last[0].rows * deviations)

    options = {"maxiter": steps, "maxfun": 2 * steps, "maxcor": MEMORY, "ftol": 1e-9, "gtol": 1e-6}
    first = walk.z[i].cpu().numpy()
    end = minimize(loss, first, jac=True, method="L-BFGS-B", callback=count, options=options)
    walk.z[i] = torch.as_tensor(end.x, device=residuals.device)
    walk.reasons[i] = "" if end.success else "the step limit was reached"
