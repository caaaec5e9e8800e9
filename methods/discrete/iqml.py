"""Iterated quadratic maximum likelihood: the difference equation of a free decay, weighed by what its noise is.

White noise e on the samples stands in ``y_j - a₁ y_(j-1) - a₂ y_(j-2)`` as ``A e``, A the banded matrix of the rows
``(-a₂, -a₁, 1)``. The likelihood of a, amplitudes eliminated, is that of ``Y a = A y`` with covariance ``σ² A Aᵀ``:
quadratic in a where that matrix is fixed. Least squares with it, the matrix renewed from the answer, and so on until
the answer stays (Y. Bresler, A. Macovski, IEEE Trans. Acoustics, Speech and Signal Processing 34:1081, 1986; the
iteration of K. Steiglitz, L. E. McBride, IEEE Trans. Automatic Control 10:461, 1965, for a free decay). It starts at
``A Aᵀ = I``, which is ``ar``; that estimate's bias is what the weight removes. ``A Aᵀ`` has five diagonals: a round
costs as many operations as there are samples. An offset is a constant among the unknowns. Since the weight is fixed
while it minimises, the end is not exactly the maximum of the likelihood.

The covariance is the bound at the answer, amplitudes and offset eliminated: ``σ² (X̂ᵀ (A Aᵀ)⁻¹ X̂)⁻¹`` for a, with X̂ the
columns of the response (first order of ``A x = 0``), σ from the residuals. Where that cannot be inverted, it is that of
a parametric bootstrap.

The initial state is estimated even where it is known: the amplitudes of the exponentials are eliminated as what the
coefficients leave open, and a known velocity is no condition on samples that is linear in them.
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
"""The iteration has settled when a round moves it by less than this part of a standard error."""
ROUNDING = 1e-11
"""Or by less than this: where there is no noise, no standard error is."""
UNSETTLED = (
    "its iteration did not settle on the difference equation of an oscillator: "
    "take a longer record, more samples a cycle or less noise"
)


@dataclass(frozen=True)
class IQML(PoleIdentifier):
    """At most ``rounds`` rounds of reweighting.

    ``bootstrap`` records are drawn where the bound cannot be computed; with ``bootstrap=0`` there is no uncertainty.
    """

    bootstrap: int = 100
    rounds: int = 60

    unreadable: ClassVar[str] = UNSETTLED
    card: ClassVar[Card] = Card(
        summary="iterated quadratic maximum likelihood (Steiglitz-McBride) of the free decay's difference equation",
        start="estimated always",
        scale="groups",
        reconstruction="simulated",
        uncertainty="inverse Fisher information at the answer, Student t with N - 4 degrees of freedom",
        settings_source="rounds: more than any development record took that settled",
        tuning="none; rounds seen on 9 development systems (damping 0.3-80 %, 0.7-40 cycles, 8-300 samples, 40-10 dB)",
        title="IQML",
        order=95,
    )

    def __post_init__(self) -> None:
        if self.rounds < 1:
            raise InputError("method.rounds", self.rounds, "at least 1")
        super().__post_init__()

    def poles_read(self, sets: np.ndarray, step: float, offset: bool) -> np.ndarray:
        columns, target = equations(sets, offset)
        first = solve(columns, target)
        settled = [reweighted(x, y, a, self.rounds) for x, y, a in zip(columns, target, first, strict=True)]
        return groups_of(np.stack(settled), step)

    def spread(self, decays: Decays) -> np.ndarray:
        return bound(decays)


def reweighted(columns: np.ndarray, target: np.ndarray, start: np.ndarray, rounds: int) -> np.ndarray:
    """Find coefficients (q,) at which the iteration stays, a₁ and a₂ first; NaN where it does not.

    ``columns`` (rows, q), ``target`` (rows,); ``start`` (q,), whose covariance weighs the first of at most ``rounds``.
    """
    a, left = start, max(target.size - start.size, 1)
    for _ in range(rounds):
        try:
            weighted = whitened(a, np.column_stack([columns, target]))
            normal = columns.T @ weighted[:, :-1]
            new = np.linalg.solve(normal, columns.T @ weighted[:, -1])
        except (np.linalg.LinAlgError, ValueError):
            break  # coefficients that are not finite, or a record without motion
        move, noise = new - a, float((target - columns @ new) @ (weighted @ np.append(-new, 1.0))) / left
        a = new
        if move @ normal @ move <= SETTLED**2 * noise or np.max(np.abs(move)) <= ROUNDING:
            return a
    return np.full(start.size, np.nan)


def whitened(a: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """``(A Aᵀ)⁻¹ columns``, shape (rows, q), for the A of coefficients that begin with a₁ and a₂.

    Raises LinAlgError or ValueError where that matrix is singular or not finite.
    """
    rows = len(columns)
    diagonals = np.zeros((3, rows))
    diagonals[0] = 1.0 + a[0] ** 2 + a[1] ** 2
    diagonals[1] = a[0] * (a[1] - 1.0)
    diagonals[2] = -a[1]
    return np.asarray(solveh_banded(diagonals[: min(3, rows)], columns, lower=True))


def bound(decays: Decays) -> np.ndarray:
    """Compute covariances (sets, 2, 2) of k/m and c/m by the Fisher information; NaN where it is singular."""
    step = step_of(decays.times)
    covariances = np.full((len(decays.groups), 2, 2), np.nan)
    columns, _ = equations(decays.centres, decays.offset)
    for i, (groups, x, noise) in enumerate(zip(decays.groups, columns, decays.noise, strict=True)):
        try:
            inverse = np.linalg.inv(x.T @ whitened(coefficients_of(groups, step), x))[:2, :2]
            back = np.linalg.inv(coefficient_slopes(groups, step))
        except (np.linalg.LinAlgError, ValueError):
            continue  # numbers that are not finite, or no information
        covariance = noise**2 * back @ inverse @ back.T
        if np.all(np.diag(covariance) > 0):
            covariances[i] = covariance
    return covariances
