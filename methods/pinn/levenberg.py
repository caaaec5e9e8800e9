"""Levenberg-Marquardt for many least-squares problems at once, each on its own: a fit is the same alone or in company.

A step solves the damped normal equations of :mod:`methods.pinn.equations`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from methods.pinn.equations import NormalEquations, equations
from methods.pinn.residuals import Residuals, State

LEAST_DAMPING = 1e-11
GREATEST_DAMPING = 1e6
"""The range of the damping, relative to the largest squared row of J."""


@dataclass
class Walk:
    """Where a batch of minimisations stands: the vectors reached (B, n_z), dampings, counts, and why each stopped.

    ``history[i]`` holds, after every accepted step of fit i, the evaluations and the residual vector in natural units
    (not divided by deviations, which change as the noise is estimated), (1 + n_rows,).
    """

    z: Tensor
    damping: np.ndarray
    evaluations: np.ndarray
    iterations: np.ndarray
    converged: np.ndarray
    reasons: list[str]
    history: list[list[np.ndarray]] = field(default_factory=list)

    @staticmethod
    def start(z: Tensor, damping: float = 1e-3) -> Walk:
        n = z.shape[0]
        count = np.zeros(n, int)
        return Walk(
            z.clone(),
            np.full(n, damping),
            count,
            count.copy(),
            np.zeros(n, bool),
            ["not started"] * n,
            [[] for _ in range(n)],
        )

    def record(self, who: np.ndarray, plain: Tensor) -> None:
        """Append to the history of the fits ``who`` (k,) their residual vectors (k, n_rows)."""
        for i, own in zip(who, np.asarray(plain.cpu()), strict=True):
            self.history[i].append(np.append(self.evaluations[i], own))


def minimise(
    residuals: Residuals,
    walk: Walk,
    deviations: Tensor,
    iterations: int,
    tolerance: float,
    who: np.ndarray | None = None,
) -> None:
    """Minimise half the squared residual vectors of the fits ``who`` from where ``walk`` stands, and update it.

    A fit stops when the linear model promises less than ``tolerance`` (the residuals are in standard deviations, so
    this is a change of minus the log posterior), or after ``iterations``. Damping: H. B. Nielsen, Damping Parameter in
    Marquardt's Method, IMM-REP-1999-05, with a floor relative to J.
    """
    active = np.arange(residuals.n_fits) if who is None else who
    walk.converged[active] = False
    growth = np.full(residuals.n_fits, 2.0)
    for i in active:
        walk.reasons[i] = "the largest number of iterations was reached"
    own, own_deviations = residuals.take(active), deviations[active]
    state = own.evaluate(walk.z[active], own_deviations)
    walk.evaluations[active] += 1
    normal: NormalEquations | None = None
    for _ in range(iterations):
        if normal is None:
            normal = equations(own, state, own_deviations)
        damping = torch.as_tensor(walk.damping[active], device=own.device) * normal.size
        step, promise = normal.solve(damping)
        promised = np.asarray(promise.cpu())
        trial = own.evaluate(state.z - step, own_deviations)
        walk.evaluations[active] += 1
        walk.iterations[active] += 1
        with np.errstate(invalid="ignore", divide="ignore"):
            gain = np.where(promised > 0, (state.loss - trial.loss) / promised, -1.0)
            accepted = gain > 0
            ended = promised < tolerance
        if accepted.any():
            state = trial if accepted.all() else _mixed(own, state, trial, accepted, own_deviations)
            normal = None
            walk.record(active[accepted], (state.rows * own_deviations)[accepted])
        ended |= _damp(walk, active, growth, gain, accepted)
        for i in np.flatnonzero(ended):
            _close(walk, int(active[i]), bool(accepted[i]), float(promised[i]), tolerance)
        if ended.any():
            walk.z[active] = state.z
            active = active[~ended]
            if not active.size:
                return
            own, own_deviations = residuals.take(active), deviations[active]
            state, normal = own.evaluate(walk.z[active], own_deviations), None
    walk.z[active] = state.z


def _mixed(own: Residuals, state: State, trial: State, accepted: np.ndarray, deviations: Tensor) -> State:
    """The accepted trials, and the old states of the others."""
    chosen = torch.as_tensor(accepted, device=own.device)[:, None]
    return own.evaluate(torch.where(chosen, trial.z, state.z), deviations)


def _damp(walk: Walk, active: np.ndarray, growth: np.ndarray, gain: np.ndarray, accepted: np.ndarray) -> np.ndarray:
    """Nielsen's update of the dampings; which fits can no longer be helped by more of it."""
    good, bad = active[accepted], active[~accepted]
    shrink = np.maximum(0.1, 1.0 - (2.0 * gain[accepted] - 1.0) ** 3)
    walk.damping[good] = np.maximum(walk.damping[good] * shrink, LEAST_DAMPING)
    growth[good] = 2.0
    walk.damping[bad] *= growth[bad]
    growth[bad] *= 2.0
    return walk.damping[active] > GREATEST_DAMPING


def _close(walk: Walk, i: int, accepted: bool, promised: float, tolerance: float) -> None:
    walk.converged[i] = promised < tolerance
    if not walk.converged[i]:
        walk.reasons[i] = "no step decreases the loss"
    elif accepted:
        walk.reasons[i] = "the linear model promises no further decrease"
    else:
        walk.reasons[i] = "no step decreases the loss further"
