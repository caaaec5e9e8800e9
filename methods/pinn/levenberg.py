"""Levenberg-Marquardt for a batch of independent least-squares problems, with results independent of the batch.

A step solves the damped normal equations of :mod:`methods.pinn.equations`.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from methods.pinn.equations import NormalEquations, equations
from methods.pinn.residuals import Residuals

LEAST_DAMPING = 1e-11
GREATEST_DAMPING = 1e6
"""The range of the damping, relative to the largest squared row of J."""


class Walk:
    """The state of a batch of minimisations: iterates z (B, n_z), dampings, counts, and reasons of termination.

    The reason of a converged minimisation is empty.
    ``history[i]`` has an entry (1 + n_rows,) for every accepted step of fit i: the number of evaluations, then the
    residual vector in natural units (not divided by deviations, which change as the noise is estimated).
    """

    def __init__(self, z: Tensor, damping: float = 1e-3) -> None:
        n = z.shape[0]
        self.z, self.damping = z.clone(), np.full(n, damping)
        self.evaluations, self.iterations = np.zeros(n, int), np.zeros(n, int)
        self.reasons = ["not started"] * n
        self.history: list[list[np.ndarray]] = [[] for _ in range(n)]

    def record(self, who: np.ndarray, plain: Tensor) -> None:
        """Append residual vectors (k, n_rows) to the histories of the fits ``who`` (k,)."""
        for i, rows in zip(who, np.asarray(plain.cpu()), strict=True):
            self.history[i].append(np.append(self.evaluations[i], rows))


def minimise(
    residuals: Residuals,
    walk: Walk,
    deviations: Tensor,
    iterations: int,
    tolerance: float,
    who: np.ndarray | None = None,
) -> None:
    """Minimise half the squared residual vectors of the fits ``who`` from the state ``walk``, and update it.

    A fit stops when the decrease predicted by the linear model is below ``tolerance`` (a change of minus the log
    posterior, since the residuals are in standard deviations), or after ``iterations``.
    """
    active = np.arange(residuals.n_fits) if who is None else who
    growth = np.full(residuals.n_fits, 2.0)
    for i in active:
        walk.reasons[i] = "the iteration limit was reached"
    selected, spread = residuals.take(active), deviations[active]
    state = selected.evaluate(walk.z[active], spread)
    walk.evaluations[active] += 1
    normal: NormalEquations | None = None
    for _ in range(iterations):
        if normal is None:
            normal = equations(selected, state, spread)
        step, decrease = normal.solve(torch.as_tensor(walk.damping[active], device=selected.device) * normal.size)
        predicted = np.asarray(decrease.cpu())
        trial = selected.evaluate(state.z - step, spread)
        walk.evaluations[active] += 1
        walk.iterations[active] += 1
        with np.errstate(invalid="ignore", divide="ignore"):
            gain = np.where(predicted > 0, (state.loss - trial.loss) / predicted, -1.0)
        accepted = gain > 0
        if accepted.any():
            chosen = torch.as_tensor(accepted, device=selected.device)[:, None]
            state = trial if accepted.all() else selected.evaluate(torch.where(chosen, trial.z, state.z), spread)
            normal = None
            walk.record(active[accepted], selected.plain(state, spread)[accepted])
        _damp(walk, active, growth, gain)
        ended = (predicted < tolerance) | (walk.damping[active] > GREATEST_DAMPING)
        if ended.any():
            for i, last in zip(active[ended], predicted[ended], strict=True):
                walk.reasons[i] = "" if last < tolerance else "no step decreases the loss"
            walk.z[active] = state.z
            active = active[~ended]
            if not active.size:
                return
            selected, spread = residuals.take(active), deviations[active]
            state, normal = selected.evaluate(walk.z[active], spread), None
    walk.z[active] = state.z


def _damp(walk: Walk, active: np.ndarray, growth: np.ndarray, gain: np.ndarray) -> None:
    """Update dampings (H. B. Nielsen, Damping Parameter in Marquardt's Method, IMM-REP-1999-05), with a floor."""
    good, bad = active[gain > 0], active[~(gain > 0)]
    shrink = np.maximum(0.1, 1.0 - (2.0 * gain[gain > 0] - 1.0) ** 3)
    walk.damping[good] = np.maximum(walk.damping[good] * shrink, LEAST_DAMPING)
    growth[good] = 2.0
    walk.damping[bad] *= growth[bad]
    growth[bad] *= 2.0
