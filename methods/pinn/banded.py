"""The normal equations of splines: a band for each record, bordered by the parameters and offsets.

A row depends on the few B-splines that are not zero at its point, so that JᵀJ by the coefficients has as many
diagonals, and work and memory grow with the record's length, not with its square or cube. The other unknowns are
eliminated by their Schur complement (C. de Boor, A Practical Guide to Splines, chapter XIV; G. Golub and C. Van Loan,
Matrix Computations, 4th edition, section 4.3). Numpy and LAPACK, one fit after the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.linalg import LinAlgError, cho_factor, cho_solve, cho_solve_banded, cholesky_banded
from torch import Tensor

from methods.network.ansatz import Adjoints, Local
from methods.pinn.residuals import Residuals, State


@dataclass(frozen=True)
class LocalRows:
    """Rows (n_rows, k) by the k coefficients that each depends on, from number ``first`` (n_rows,) of ``n`` on.

    The coefficients are ordered by time: the first function of all paths, then the second, and so on.
    """

    first: np.ndarray
    slopes: np.ndarray
    n: int

    @staticmethod
    def of(ansatz: Local, adjoints: Adjoints, points: Tensor, i: int) -> LocalRows:
        """Return the rows of fit i at some of the points."""
        slopes = ansatz.slopes(adjoints[0], points)[i].transpose(1, 2).flatten(1)
        first = ansatz.first[i, points] * ansatz.n_paths
        return LocalRows(first.cpu().numpy(), slopes.cpu().numpy(), ansatz.count)

    def band(self) -> np.ndarray:
        """Return the lower diagonals of JᵀJ, (k, n)."""
        k = self.slopes.shape[1]
        diagonals = np.zeros((k, self.n))
        for below in range(k):
            for a in range(k - below):
                weights = self.slopes[:, a] * self.slopes[:, a + below]
                diagonals[below] += np.bincount(self.first + a, weights, self.n)
        return diagonals

    def pull_back(self, columns: np.ndarray) -> np.ndarray:
        """Return Jᵀ times columns (n_rows, m)."""
        total = np.zeros((self.n, columns.shape[1]))
        for j, column in enumerate(columns.T):
            for a, slopes in enumerate(self.slopes.T):
                total[:, j] += np.bincount(self.first + a, slopes * column, self.n)
        return total

    def times(self, columns: np.ndarray) -> np.ndarray:
        """Return J times columns (n, m)."""
        return np.asarray(sum(s[:, None] * columns[self.first + a] for a, s in enumerate(self.slopes.T)))

    def quadratic(self, band: np.ndarray) -> np.ndarray:
        """Return the products of each row with a symmetric matrix on both sides, given its lower diagonals (k, n)."""
        k, total = self.slopes.shape[1], np.zeros(self.first.size)
        for below in range(k):
            for a in range(k - below):
                share = self.slopes[:, a] * self.slopes[:, a + below] * band[below, self.first + a]
                total += share if below == 0 else 2.0 * share
        return total


@dataclass(frozen=True)
class Elimination:
    """One fit's equations with the coefficients eliminated: record by record the band's Cholesky factor and its
    solutions for the border (n, n_unknowns + 1), the right-hand side last; and the Schur complement of the others.
    """

    factors: list[np.ndarray]
    solved: list[np.ndarray]
    corner: np.ndarray


class BandedEquations:
    """The damped normal equations, as :class:`methods.pinn.levenberg.PrimalEquations`."""

    def __init__(self, residuals: Residuals, state: State, deviations: Tensor) -> None:
        linear = residuals.linearise(state, deviations)
        right = torch.cat([linear.columns, state.rows[..., None]], 2).cpu().numpy()
        self.residuals, self.n_unknowns = residuals, residuals.n_unknowns
        self.rows: list[list[LocalRows]] = []
        self.bands: list[list[np.ndarray]] = []
        self.borders: list[list[np.ndarray]] = []
        self.corners = right.transpose(0, 2, 1) @ right
        squares = np.sum(right[..., :-1] ** 2, 2)
        for i in range(residuals.n_fits):
            own, first = [], 0
            for block, ansatz, adjoints in zip(residuals.blocks, residuals.ansatzes, linear.adjoints, strict=True):
                assert isinstance(ansatz, Local)
                own.append(LocalRows.of(ansatz, adjoints, block.points, i))
                squares[i, first : first + block.n_rows] += np.sum(own[-1].slopes ** 2, 1)
                first += block.n_rows
            ends = np.cumsum([block.n_rows for block in residuals.blocks])
            parts = np.split(right[i], ends)[:-1]
            self.bands.append([rows.band() for rows in own])
            self.borders.append([rows.pull_back(part) for rows, part in zip(own, parts, strict=True)])
        self.size = torch.as_tensor(squares.max(1), device=residuals.device)

    @property
    def trace(self) -> Tensor:
        """The sum of all squared entries of J, (B,)."""
        sums = [sum(float(band[0].sum()) for band in own) for own in self.bands]
        corners = np.trace(self.corners[:, :-1, :-1], axis1=1, axis2=2)
        return torch.as_tensor(np.array(sums) + corners, device=self.residuals.device)

    def eliminate(self, i: int, damping: float) -> Elimination:
        """Eliminate the coefficients of fit i, with a damping added to their diagonal.

        Raises:
            LinAlgError: Where the band is not positive definite.
        """
        corner = self.corners[i].copy()
        factors, solved = [], []
        for band, border in zip(self.bands[i], self.borders[i], strict=True):
            damped = band.copy()
            damped[0] += damping
            factors.append(cholesky_banded(damped, lower=True, check_finite=False))
            solved.append(cho_solve_banded((factors[-1], True), border, check_finite=False))
            corner -= border.T @ solved[-1]
        return Elimination(factors, solved, corner)

    def solve(self, damping: Tensor) -> tuple[Tensor, Tensor]:
        """Steps to subtract (B, n_z), and the decrease of the loss that the linear model promises (B,)."""
        steps = np.stack([self._step(i, own) for i, own in enumerate(damping.tolist())])
        gradients = np.stack([
            np.concatenate([*self._by_path([own[:, -1] for own in borders]), corner[:-1, -1]])
            for borders, corner in zip(self.borders, self.corners, strict=True)
        ])  # fmt: skip
        promises = 0.5 * np.sum(steps * (damping.cpu().numpy()[:, None] * steps + gradients), 1)
        device = self.residuals.device
        return torch.as_tensor(steps, device=device), torch.as_tensor(promises, device=device)

    def _step(self, i: int, damping: float) -> np.ndarray:
        q = self.n_unknowns
        try:
            eliminated = self.eliminate(i, damping)
            corner = eliminated.corner[:q, :q] + damping * np.eye(q)
            unknowns = cho_solve(cho_factor(corner), eliminated.corner[:q, q]) if q else np.zeros(0)
        except (LinAlgError, ValueError):
            return np.full(self.residuals.n_z, np.nan)
        parts = [own[:, q] - own[:, :q] @ unknowns for own in eliminated.solved]
        return np.concatenate([*self._by_path(parts), unknowns])

    def _by_path(self, parts: list[np.ndarray]) -> list[np.ndarray]:
        """Coefficients of each record in the order of its ansatz: those of the first path, then of the second."""
        return [
            part.reshape(-1, block.n_paths).T.ravel() for part, block in zip(parts, self.residuals.blocks, strict=True)
        ]


def inverse_band(factor: np.ndarray) -> np.ndarray:
    """The lower diagonals (k, n) of the inverse of ``L Lᵀ``, given those of L.

    Each column follows from the k - 1 after it, the last first (K. Takahashi, J. Fagan and M. Chen, 8th PICA
    Conference, 1973).
    """
    k, n = factor.shape
    band, after = np.zeros((k, n)), np.zeros((k - 1, k - 1))
    for j in range(n - 1, -1, -1):
        pivot, below = factor[0, j], factor[1:, j]
        column = after @ below / -pivot
        diagonal = 1.0 / pivot**2 - below @ column / pivot
        band[0, j], band[1:, j] = diagonal, column
        after[1:, 1:] = after[:-1, :-1].copy()
        after[0, 0], after[0, 1:], after[1:, 0] = diagonal, column[:-1], column[:-1]
    return band
