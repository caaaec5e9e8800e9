"""Nonlinear least squares for a batch of problems.

Levenberg-Marquardt (K. Levenberg, Q. Appl. Math. 2:164, 1944; D. W. Marquardt, J. SIAM 11:431, 1963): a step solves
``(JᵀJ + d diag JᵀJ) step = -Jᵀr``; the damping d falls where the step lowers the cost and rises where it does not. A
*case* is one problem with one initial guess; its result does not depend on the other cases of the batch.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

SETTLED = 1e-8
"""A search has converged when a Gauss-Newton step would lower the sum of squares by less. Residuals are in standard
deviations, so this is far below the statistical uncertainty."""
FIRST_DAMPING = 1e-3
"""Initial damping of a search."""
MOST_DAMPING = 1e12
"""Damping above which a search stops."""
EASED, STIFFENED = 0.3, 8.0
"""Factors of the damping after a step that lowers the cost, and after a step that does not."""
LEAST_CONDITION = 1e-9
"""Smallest ratio of singular values of scaled derivatives; below it, a direction counts as not identifiable."""
ROUNDING = 1e-9
"""Relative increase of a cost that rounding may cause."""


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Residuals of a batch and their derivatives.

    Attributes:
        unknowns: Unknowns, shape (cases, size).
        residuals: Standardised residuals, shape (cases, N).
        slopes: Derivatives of the residuals by the unknowns, shape (cases, N, size).
        cost: Minimised function, shape (cases,): the sum of squares, unless a likelihood defines another; infinite if
            a number is not finite.
    """

    unknowns: np.ndarray
    residuals: np.ndarray
    slopes: np.ndarray
    cost: np.ndarray

    @staticmethod
    def of(unknowns: np.ndarray, residuals: np.ndarray, slopes: np.ndarray) -> Linearisation:
        """Create a linearisation whose cost is the sum of squares.

        Args:
            unknowns: Unknowns, shape (cases, size).
            residuals: Standardised residuals, shape (cases, N).
            slopes: Derivatives of the residuals, shape (cases, N, size).

        Returns:
            The linearisation.
        """
        # a finite sum implies finite terms; an overflowing sum is treated as not finite
        with np.errstate(all="ignore"):
            cost = np.sum(residuals**2, axis=1)
            finite = np.isfinite(cost) & np.isfinite(np.sum(slopes, axis=(1, 2)))
        return Linearisation(unknowns, residuals, slopes, np.where(finite, cost, np.inf))

    def __getitem__(self, cases: np.ndarray) -> Linearisation:
        return Linearisation(self.unknowns[cases], self.residuals[cases], self.slopes[cases], self.cost[cases])

    def put(self, cases: np.ndarray, new: Linearisation) -> None:
        """Replace some cases in place.

        Args:
            cases: Indices of the cases.
            new: Their new linearisation.
        """
        self.unknowns[cases], self.residuals[cases] = new.unknowns, new.residuals
        self.slopes[cases], self.cost[cases] = new.slopes, new.cost


Evaluate = Callable[[np.ndarray, np.ndarray], Linearisation]
"""Function of indices of cases (n,) and their unknowns (n, size) that returns the linearisation."""
Steps = Callable[[Linearisation, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Function of a linearisation and the damping of each case that returns the step, and the decrease of the cost that a
Gauss-Newton step would achieve."""


@dataclass(frozen=True, eq=False)
class Minimum:
    """Result of a search.

    Attributes:
        point: Linearisation at the best unknowns.
        left: Decrease of the cost that a Gauss-Newton step would achieve, shape (cases,).
        done: True if the search has converged or cannot improve, shape (cases,).
        iterations: Number of trial steps, shape (cases,).
    """

    point: Linearisation
    left: np.ndarray
    done: np.ndarray
    iterations: np.ndarray


@dataclass(frozen=True, eq=False)
class StepLimits:
    """Limits of a search.

    Attributes:
        step: Largest change of each unknown in one step, shape (size,).
        size: Largest magnitude of each unknown, shape (size,).
    """

    step: np.ndarray
    size: np.ndarray

    def trial(self, unknowns: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Apply a step within the limits.

        Args:
            unknowns: Unknowns, shape (cases, size).
            step: Proposed step, shape (cases, size).

        Returns:
            Unknowns after the step.
        """
        return np.clip(unknowns + np.clip(step, -self.step, self.step), -self.size, self.size)


def dense_steps(point: Linearisation, damping: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Solve the damped normal equations with scaled unknowns; the function has the signature of :data:`Steps`."""
    transposed = np.swapaxes(point.slopes, 1, 2)
    hessian, gradient = transposed @ point.slopes, -(transposed @ point.residuals[..., None])[..., 0]
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
    """Minimise the cost of every case from its initial guess.

    Args:
        evaluate: Function that returns the linearisation of cases given by index.
        start: Linearisation of all cases at the initial guesses.
        iterations: Largest number of trial steps.
        limits: Limits of steps and unknowns; None for no limits.
        damping: Initial damping; about 1 for a poor initial guess.
        steps: Solver of the damped linear problem, to be replaced for banded derivatives or more unknowns than
            residuals.

    Returns:
        The minimum of every case.
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
        # the step is below rounding, or the damping has grown without a decrease of the cost
        small = np.max(np.abs(step) / np.maximum(1.0, np.abs(best.unknowns[going])), axis=1) < 1e-12
        done[going] |= small | (dampings[going] > MOST_DAMPING)
    return Minimum(best, left, done, taken)


def polish(evaluate: Evaluate, point: Linearisation) -> Linearisation:
    """Take one more Gauss-Newton step in every case, unless it increases the cost by more than rounding.

    The error of the unknowns at convergence is of the order of the square root of the remaining decrease of the cost.
    """
    every = np.arange(len(point.cost))
    step, _ = dense_steps(point, np.zeros(every.size))
    trial = evaluate(every, point.unknowns + step)
    # with a tolerance for rounding, so that results do not depend on the batch
    kept = trial.cost <= point.cost * (1.0 + ROUNDING) + ROUNDING
    polished = point[every]
    polished.put(every[kept], trial[kept])
    return polished


def degrees_used(slopes: np.ndarray, samples: int) -> np.ndarray:
    """Compute ``trace(H_data H^-1)``, the effective number of parameters estimated from the data.

    Args:
        slopes: Derivatives of standardised residuals, shape (cases, N, size): first of the data, then of a prior.
        samples: Number of rows that belong to the data.

    Returns:
        Degrees of freedom used, shape (cases,).
    """
    basis, values, _ = np.linalg.svd(slopes, full_matrices=False)
    determined = values > 1e-12 * values[:, :1]
    return np.asarray(np.sum(np.sum(basis[:, :samples] ** 2, axis=1) * determined, axis=1))


def covariances(slopes: np.ndarray) -> list[np.ndarray | None]:
    """Invert ``JᵀJ`` for derivatives (cases, N, size); None for a case with a direction that is not identifiable."""
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
