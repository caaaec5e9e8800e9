"""Levenberg-Marquardt in the dual: a step costs a system of the size of the residual vector, not of the network."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from torch import Tensor

from methods.pinn.residuals import Linear, Residuals, State

LEAST_DAMPING = 1e-11
GREATEST_DAMPING = 1e6
"""The range of the damping, relative to the largest diagonal entry of J Jᵀ."""


@dataclass
class Walk:
    """Where a minimisation stands: the state reached, the damping, the counts, and why it stopped."""

    state: State
    damping: float = 1e-3
    evaluations: int = 0
    iterations: int = 0
    reason: str = "the largest number of iterations was reached"
    converged: bool = False
    history: list[dict[str, float]] = field(default_factory=list)


def step(gram: Tensor, rows: Tensor, damping: float) -> tuple[Tensor, float] | None:
    """The dual vector ``(J Jᵀ + damping I)⁻¹ r`` and the reduction of ``|r|²/2`` that the linear model promises.

    The step of Levenberg and Marquardt, ``-(Jᵀ J + damping I)⁻¹ Jᵀ r``, is ``-Jᵀ`` times that vector (push-through
    identity). It leaves the linear residual ``damping * dual``. None where the matrix is not positive definite.
    """
    matrix = gram.clone()
    matrix.diagonal().add_(damping)
    factor, info = torch.linalg.cholesky_ex(matrix)
    if int(info) != 0:
        return None
    dual = torch.cholesky_solve(rows[:, None], factor)[:, 0]
    left = damping * dual
    promised = 0.5 * float((rows - left) @ (rows + left))
    return dual, promised


def minimise(
    residuals: Residuals,
    walk: Walk,
    deviations: Tensor,
    iterations: int,
    tolerance: float,
    unknown_scale: float = 1.0,
    output_only: bool = False,
    on_accept: Callable[[State], None] | None = None,
) -> Walk:
    """Minimise half the squared residual vector from ``walk.state`` and ``walk.damping``, with the damping of Nielsen.

    Stops when the linear model promises less than ``tolerance`` (the residuals are in standard deviations, so this
    is a change of minus the log posterior), or after ``iterations``. Damping: H. B. Nielsen, Damping Parameter in
    Marquardt's Method, IMM-REP-1999-05, with a floor relative to J Jᵀ. ``output_only`` moves the last layer and the
    unknowns beside the weights only. Updates and returns ``walk``.
    """
    state = residuals.evaluate(walk.state.z, deviations)
    walk.evaluations += 1
    walk.converged, walk.reason = False, "the largest number of iterations was reached"
    growth = 2.0
    gram: Tensor | None = None
    linear: Linear | None = None
    size = 1.0
    for _ in range(iterations):
        if gram is None or linear is None:
            linear = residuals.linearise(state, deviations, output_only)
            gram = residuals.gram(state, linear, unknown_scale, output_only)
            size = float(gram.diagonal().max())
        walk.iterations += 1
        solved = step(gram, state.rows, walk.damping * size)
        gain = -1.0
        if solved is not None:
            dual, promised = solved
            trial = residuals.evaluate(
                state.z - residuals.pull_back(state, linear, dual, unknown_scale, output_only), deviations
            )
            walk.evaluations += 1
            gain = (state.loss - trial.loss) / promised if promised > 0 else -1.0
            if not gain > -1e300:
                gain = -1.0
        if gain > 0:
            state = trial
            gram = linear = None
            walk.damping = max(walk.damping * max(1 / 10, 1 - (2 * gain - 1) ** 3), LEAST_DAMPING)
            growth = 2.0
            walk.history.append(state.terms)
            if promised < tolerance:
                walk.converged, walk.reason = True, "the linear model promises no further decrease"
                break
        else:
            if solved is not None and promised < tolerance:
                walk.converged, walk.reason = True, "no step decreases the loss further"
                break
            walk.damping *= growth
            growth *= 2.0
            if walk.damping > GREATEST_DAMPING:
                walk.reason = "no step decreases the loss"
                break
    walk.state = state
    return walk
