"""Nonlinear least squares for many problems at once: the search of everything that has residuals and derivatives.

Levenberg-Marquardt (K. Levenberg, Q. Appl. Math. 2:164, 1944; D. W. Marquardt, J. SIAM 11:431, 1963): a step solves
``(JᵀJ + d diag JᵀJ) step = -Jᵀr``; the damping d falls where the step lowers the cost and rises where it does not. A
*case* is one problem with one initial guess; a case is searched alike alone and in a batch.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

SETTLED = 1e-8
"""A search has converged where a Gauss-Newton step would lower the sum of squares by less: residuals are in standard
deviations, so that is next to nothing."""
FIRST_DAMPING = 1e-3
MOST_DAMPING = 1e12
"""Damping of a search at first, and beyond which it ends."""
EASED, STIFFENED = 0.3, 8.0
"""Factors of the damping after a step that lowers the cost, and after one that does not."""
LEAST_CONDITION = 1e-9
"""Smallest over largest singular value of scaled derivatives below which a direction counts as open."""
ROUNDING = 1e-9
"""Part of a cost that rounding may add."""


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Unknowns (cases, size), residuals (cases, N) there and their derivatives (cases, N, size).

    ``cost`` (cases,) is what a search lowers: the sum of squares, unless a likelihood has another one; infinite where a
    number is not finite.
    """

    unknowns: np.ndarray
    residuals: np.ndarray
    slopes: np.ndarray
    cost: np.ndarray

    @staticmethod
    def of(unknowns: np.ndarray, residuals: np.ndarray, slopes: np.ndarray) -> Linearisation:
        """Collect residuals and derivatives whose cost is the sum of squares."""
        # a sum is finite where all of its terms are; where terms overflow, they are of no use either
        with np.errstate(all="ignore"):
            cost = np.sum(residuals**2, axis=1)
            finite = np.isfinite(cost) & np.isfinite(np.sum(slopes, axis=(1, 2)))
        return Linearisation(unknowns, residuals, slopes, np.where(finite, cost, np.inf))

    def __getitem__(self, cases: np.ndarray) -> Linearisation:
        return Linearisation(self.unknowns[cases], self.residuals[cases], self.slopes[cases], self.cost[cases])

    def put(self, cases: np.ndarray, new: Linearisation) -> None:
        """Replace some cases."""
        self.unknowns[cases], self.residuals[cases] = new.unknowns, new.residuals
        self.slopes[cases], self.cost[cases] = new.slopes, new.cost


Evaluate = Callable[[np.ndarray, np.ndarray], Linearisation]
"""Numbers of cases (n,) and their unknowns (n, size) -> residuals and derivatives there."""
Steps = Callable[[Linearisation, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""A linearisation and the damping of each case -> its step, and by how much an undamped one would lower the cost."""


@dataclass(frozen=True, eq=False)
class Minimum:
    """Where a search ended.

    ``left`` (cases,): by how much a Gauss-Newton step would still lower the cost. ``done`` (cases,): no more steps are
    worth taking. ``iterations`` (cases,).
    """

    at: Linearisation
    left: np.ndarray
    done: np.ndarray
    iterations: np.ndarray


@dataclass(frozen=True, eq=False)
class StepLimits:
    """Largest change of each unknown in one step, and largest size of each unknown, both (size,)."""

    step: np.ndarray
    size: np.ndarray

    def trial(self, unknowns: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Return the unknowns after a step, within the limits."""
        return np.clip(unknowns + np.clip(step, -self.step, self.step), -self.size, self.size)


def dense_steps(at: Linearisation, damping: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Solve the damped normal equations, with unknowns scaled to derivatives of equal size."""
    transposed = np.swapaxes(at.slopes, 1, 2)
    hessian, gradient = transposed @ at.slopes, -(transposed @ at.residuals[..., None])[..., 0]
    sizes = np.sqrt(np.diagonal(hessian, axis1=1, axis2=2)) + 1e-150
    scaled = hessian / (sizes[:, :, None] * sizes[:, None, :])
    ridge = np.stack([np.zeros_like(damping), damping], axis=1)[..., None, None] + 1e-14
    right = gradient / sizes
    both = np.linalg.solve(scaled[:, None] + ridge * np.eye(sizes.shape[1]), right[:, None, :, None])[..., 0]
    return both[:, 1] / sizes, np.sum(both[:, 0] * right, axis=1)


def minimise(
    evaluate: Evaluate,
    start: Linearisation,
    iterations: int,
    limits: StepLimits | None = None,
    damping: float = FIRST_DAMPING,
    steps: Steps = dense_steps,
) -> Minimum:
    """Lower the cost of every case from where it starts.

    Args:
        evaluate: gives residuals and derivatives of cases by their numbers.
        start: of all cases, in order.
        iterations: trial steps, at most.
        limits: of steps and unknowns.
        damping: at first; around 1 where nothing says that the start is near.
        steps: solves the damped linear problem; another one where derivatives are banded, or unknowns outnumber
            residuals.
    """
    n = len(start.cost)
    best = start[np.arange(n)]
    dampings, taken, left = np.full(n, damping), np.zeros(n, int), np.full(n, np.inf)
    done = ~np.isfinite(best.cost)
    for number in range(iterations + 1):
        going = np.flatnonzero(~done)
        if not going.size:
            break
        now = best[going]
        step, left[going] = steps(now, dampings[going])
        done[going] = left[going] < SETTLED
        unsettled = ~done[going]
        going, step, unknowns = going[unsettled], step[unsettled], now.unknowns[unsettled]
        if number == iterations or not going.size:
            break
        trial = evaluate(going, unknowns + step if limits is None else limits.trial(unknowns, step))
        lower = trial.cost < best.cost[going]
        best.put(going[lower], trial[lower])
        taken[going] += 1
        dampings[going] *= np.where(lower, EASED, STIFFENED)
        # a step that rounding undoes, or one that has become next to nothing without a gain
        small = np.max(np.abs(step) / np.maximum(1.0, np.abs(best.unknowns[going])), axis=1) < 1e-12
        done[going] |= small | (dampings[going] > MOST_DAMPING)
    return Minimum(best, left, done, taken)


def polish(evaluate: Evaluate, at: Linearisation) -> Linearisation:
    """Take one more Gauss-Newton step in every case, kept where it does not lose more than rounding.

    A search ends where little is left to gain; the square of what is left in the unknowns is that little.
    """
    every = np.arange(len(at.cost))
    step, _ = dense_steps(at, np.zeros(every.size))
    trial = evaluate(every, at.unknowns + step)
    # rounding must not decide, or an answer would depend on its batch
    kept = trial.cost <= at.cost * (1.0 + ROUNDING) + ROUNDING
    polished = at[every]
    polished.put(every[kept], trial[kept])
    return polished


def degrees_used(slopes: np.ndarray, samples: int) -> np.ndarray:
    """Compute ``trace(H_data H^-1)``, the degrees of freedom that the data spent, (cases,).

    ``slopes`` (cases, N, size) are derivatives of standardised residuals, of the data in the first ``samples`` rows and
    of a prior in the others.
    """
    basis, values, _ = np.linalg.svd(slopes, full_matrices=False)
    determined = values > 1e-12 * values[:, :1]
    return np.asarray(np.sum(np.sum(basis[:, :samples] ** 2, axis=1) * determined, axis=1))


def covariances(slopes: np.ndarray) -> list[np.ndarray | None]:
    """Invert ``JᵀJ`` of every case, of derivatives (cases, N, size); None where they leave a direction open."""
    sizes = np.sqrt(np.sum(slopes**2, axis=1))
    usable = np.all(np.isfinite(sizes) & (sizes > 0), axis=1) & (slopes.shape[1] >= slopes.shape[2])
    inverses: list[np.ndarray | None] = [None] * len(slopes)
    if np.any(usable):
        sizes = sizes[usable]
        _, values, axes = np.linalg.svd(slopes[usable] / sizes[:, None], full_matrices=False)
        closed = values[:, -1] >= LEAST_CONDITION * values[:, 0]
        roots = np.swapaxes(axes, 1, 2) / np.where(closed[:, None], values, 1.0)[:, None] / sizes[..., None]
        for i, whole, inverse in zip(np.flatnonzero(usable), closed, roots @ np.swapaxes(roots, 1, 2), strict=True):
            inverses[i] = inverse if whole else None
    return inverses
