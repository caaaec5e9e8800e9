"""Iterated quadratic maximum likelihood (IQML) on the difference equation of a free decay.

White noise e of the samples appears in ``y_j - a₁ y_(j-1) - a₂ y_(j-2)`` as ``A e``, with the banded matrix A of rows
``(-a₂, -a₁, 1)``. With the amplitudes eliminated, minus twice the log-likelihood of a is ``(A y)ᵀ (A Aᵀ)⁻¹ A y / σ²``
but for a constant, which is quadratic in a for a fixed matrix ``A Aᵀ``. Weighted least squares and an update of the
matrix are iterated until convergence (Y. Bresler, A. Macovski, IEEE Trans. Acoustics, Speech and Signal Processing
34:1081, 1986; the iteration of K. Steiglitz, L. E. McBride, IEEE Trans. Automatic Control 10:461, 1965, for a free
decay). The first step with ``A Aᵀ = I`` is ``ar``, whose bias the weight removes. ``A Aᵀ`` has five diagonals, so the
cost of a step is proportional to the number of samples. An offset is a constant among the unknowns. Since the weight is
fixed in each minimisation, the result is not exactly the maximum of the likelihood.

The covariance is the Cramér-Rao bound at the estimate, with amplitudes and offset eliminated:
``σ² (X̂ᵀ (A Aᵀ)⁻¹ X̂)⁻¹`` for a, with the columns X̂ of the response (to first order in ``A x = 0``) and σ from the
residuals. Where the matrix is singular, a parametric bootstrap is used.

The initial state is estimated even where it is known: the elimination of the amplitudes cannot use a known velocity,
which is no linear condition on the samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.linalg import solveh_banded

from bench import Card, InputError
from methods.discrete.ar import coefficient_slopes, coefficients_of, equations, groups_of
from methods.modal.free_decay import Decays, PoleIdentifier
from methods.modal.realisation import step_of
from methods.regression.equation import solve

SETTLED = 1e-4
"""The iteration has converged when a step is below this fraction of a standard error,"""
ROUNDING = 1e-11
"""or below this value, since without noise the standard error is zero."""
UNSETTLED = (
    "its iteration did not converge to the difference equation of an oscillator: "
    "a longer record, more samples per cycle or less noise are required"
)


@dataclass(frozen=True)
class IQML(PoleIdentifier):
    """IQML with at most ``rounds`` iterations of reweighting.

    ``bootstrap``: synthetic records for the covariance where the bound is singular; with 0 there is none then.
    """

    bootstrap: int = 100
    rounds: int = 60

    unreadable: ClassVar[str] = UNSETTLED
    card: ClassVar[Card] = Card(
        summary="iterated quadratic maximum likelihood (Steiglitz-McBride) of the free decay's difference equation",
        start="estimated always",
        scale="groups",
        reconstruction="simulated",
        uncertainty="inverse Fisher information at the estimate, Student t with N - 4 degrees of freedom",
        settings_source="rounds: more than any converged development record needed",
        tuning="none; rounds checked on 9 systems (damping 0.3-80 %, 0.7-40 cycles, 8-300 samples, 40-10 dB)",
        title="IQML",
        order=95,
    )

    def __post_init__(self) -> None:
        if self.rounds < 1:
            raise InputError("method.rounds", self.rounds, "at least 1")
        super().__post_init__()

    def from_poles(self, sets: np.ndarray, step: float, offset: bool) -> np.ndarray:
        columns, target = equations(sets, offset)
        first = solve(columns, target)
        converged = [reweighted(x, y, a, self.rounds) for x, y, a in zip(columns, target, first, strict=True)]
        return groups_of(np.stack(converged), step)

    def spread(self, decays: Decays) -> np.ndarray:
        return bound(decays)


def reweighted(columns: np.ndarray, target: np.ndarray, start: np.ndarray, rounds: int) -> np.ndarray:
    """Iterate reweighted least squares to convergence.

    Args:
        columns: Regressors, (rows, q).
        target: Target, (rows,).
        start: Coefficients of the first weight, (q,).
        rounds: Largest number of iterations.

    Returns:
        The coefficients (q,), a₁ and a₂ first; NaN without convergence.
    """
    a, freedom = start, max(target.size - start.size, 1)
    for _ in range(rounds):
        try:
            weighted = whitened(a, np.column_stack([columns, target]))
            normal = columns.T @ weighted[:, :-1]
            new = np.linalg.solve(normal, columns.T @ weighted[:, -1])
        except (np.linalg.LinAlgError, ValueError):
            break  # coefficients that are not finite, or a record without motion
        move, noise = new - a, float((target - columns @ new) @ (weighted @ np.append(-new, 1.0))) / freedom
        a = new
        if move @ normal @ move <= SETTLED**2 * noise or np.max(np.abs(move)) <= ROUNDING:
            return a
    return np.full(start.size, np.nan)


def whitened(a: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Compute ``(A Aᵀ)⁻¹ columns``, (rows, q), for A of the coefficients a, which begin with a₁ and a₂.

    Raises LinAlgError or ValueError where that matrix is singular or not finite.
    """
    rows = len(columns)
    diagonals = np.zeros((3, rows))
    diagonals[0] = 1.0 + a[0] ** 2 + a[1] ** 2
    diagonals[1] = a[0] * (a[1] - 1.0)
    diagonals[2] = -a[1]
    return np.asarray(solveh_banded(diagonals[: min(3, rows)], columns, lower=True))


def bound(decays: Decays) -> np.ndarray:
    """Compute the Cramér-Rao bounds (sets, 2, 2) of k/m and c/m; NaN where the information is singular."""
    step = step_of(decays.times)
    covariances = np.full((len(decays.groups), 2, 2), np.nan)
    columns, _ = equations(decays.centres, decays.offset)
    for i, (groups, x, noise) in enumerate(zip(decays.groups, columns, decays.noise, strict=True)):
        try:
            inverse = np.linalg.inv(x.T @ whitened(coefficients_of(groups, step), x))[:2, :2]
            back = np.linalg.inv(coefficient_slopes(groups, step))
        except (np.linalg.LinAlgError, ValueError):
            continue  # not finite, or no information
        covariance = noise**2 * back @ inverse @ back.T
        if np.all(np.diag(covariance) > 0):
            covariances[i] = covariance
    return covariances
