"""The damped normal equations ``(JᵀJ + μI) h = Jᵀ r`` of a residual vector, in the space of smaller dimension.

A network has 4,400 weights and some 230 residuals, so its equations are solved in residual space, where ``h = Jᵀ (JJᵀ
+ μI)⁻¹ r`` (push-through identity). Where residuals outnumber unknowns (the output layer alone, thousands of samples)
they are solved in the space of the unknowns; those of splines and windows are banded, bordered by parameters and
offsets. Each form also gives the Gauss-Newton approximation of the posterior (Laplace's method). The coefficients have
a prior precision that is tiny against the information of data and physics, which leaves smooth changes of x(t) free;
without it, a network of this size could take any value between its collocation points.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.linalg import LinAlgError, cho_factor, cho_solve, cho_solve_banded, cholesky_banded
from scipy.sparse import csr_array
from torch import Tensor

from methods.network.ansatz import Adjoints, Local
from methods.pinn.residuals import Residuals, State

PRECISION = 1e-10
"""Precision of the coefficients in the posterior, relative to the largest squared row of J."""
LEAST_INFORMATION = 1e-100
"""Least information on an unknown, so that undetermined ones have a finite, huge variance."""
SINGULAR = 1e-14
"""Least eigenvalue of the scaled information over the largest, above rounding errors."""


@dataclass
class LaplacePosterior:
    """Gauss-Newton approximation of the posterior.

    ``covariance`` (B, n_unknowns, n_unknowns): of parameters and offsets, with the coefficients profiled out.
    ``variances``, one (B, n_dof * collocation) per record: of the displacements at the collocation points, ordered by
    DOF.
    """

    covariance: Tensor
    variances: list[Tensor]

    @property
    def deviations(self) -> list[np.ndarray]:
        """Return the standard deviations of the displacements, one array per record."""
        return [np.asarray(variance.clamp(min=0.0).sqrt().cpu()) for variance in self.variances]


def equations(residuals: Residuals, state: State, deviations: Tensor) -> NormalEquations:
    """Return the normal equations at a state in the smaller space, banded ones for splines."""
    if all(ansatz.local for ansatz in residuals.ansatzes):
        return BandedEquations(residuals, state, deviations)
    dual = residuals.n_rows <= residuals.n_z
    return (DualEquations if dual else PrimalEquations)(residuals, state, deviations)


class NormalEquations(ABC):
    """The normal equations of all fits; ``size`` (B,): largest squared row of J, ``trace`` (B,): sum of squares."""

    size: Tensor
    trace: Tensor

    def __init__(self, residuals: Residuals, state: State, deviations: Tensor) -> None:
        self.residuals, self.state = residuals, state
        self.linear = residuals.linearise(state, deviations)

    @abstractmethod
    def solve(self, damping: Tensor) -> tuple[Tensor, Tensor]:
        """Return steps to subtract (B, n_z), and the decrease of the loss predicted by the linear model (B,).

        The decrease is NaN where the damped matrix is not positive definite.
        """

    @abstractmethod
    def posterior(self) -> LaplacePosterior:
        """Approximate the posterior at the state."""

    def displacements(self, k: int) -> tuple[Adjoints, Tensor]:
        """Return adjoints and points of rows for the displacements of record k at the collocation points."""
        block, ansatz = self.residuals.blocks[k], self.residuals.ansatzes[k]
        n, m = block.n_dof, block.collocation
        points = torch.arange(m, device=self.state.z.device).repeat(n)
        seeds = self.state.z.new_zeros(self.residuals.n_fits, 3, n * m, block.n_paths)
        seeds[:, 0, :, :n] = torch.eye(n, dtype=seeds.dtype, device=seeds.device).repeat_interleave(m, 0)
        part = self.residuals.split_flat(self.state.z)[0][k]
        return ansatz.adjoint(part, self.state.tapes[k], block.response_adjoint(seeds, points), points), points


def inverse(information: Tensor) -> Tensor:
    """Invert information matrices (B, n, n) after scaling their diagonals to 1.

    Combinations of unknowns that the data do not determine get a large variance.
    """
    scale = information.diagonal(dim1=1, dim2=2).clamp(min=LEAST_INFORMATION).rsqrt()
    both = scale[:, :, None] * scale[:, None]
    values, axes = torch.linalg.eigh(information * both)
    values = values.clamp(min=SINGULAR * values[:, -1:])
    return (axes / values[:, None]) @ axes.mT * both


def _damped(matrix: Tensor, damping: Tensor) -> Tensor:
    matrix = matrix.clone()
    matrix.diagonal(dim1=1, dim2=2).add_(damping[:, None])
    return matrix


class DualEquations(NormalEquations):
    """The equations in residual space."""

    def __init__(self, residuals: Residuals, state: State, deviations: Tensor) -> None:
        super().__init__(residuals, state, deviations)
        self.gram = residuals.gram(state, self.linear)
        squares = self.gram.diagonal(dim1=1, dim2=2)
        self.size, self.trace = squares.amax(1), squares.sum(1)

    def solve(self, damping: Tensor) -> tuple[Tensor, Tensor]:
        # the linear residual after the step is ``μ (JJᵀ + μI)⁻¹ r``
        factor, info = torch.linalg.cholesky_ex(_damped(self.gram, damping))
        rows = self.state.rows
        dual = torch.cholesky_solve(rows[..., None], factor)[..., 0]
        residual = damping[:, None] * dual
        decrease = 0.5 * ((rows - residual) * (rows + residual)).sum(1)
        step = self.residuals.pull_back(self.state, self.linear, dual)
        return step, torch.where(info == 0, decrease, torch.nan)

    def posterior(self) -> LaplacePosterior:
        """Approximate the posterior at the state.

        With ``M = Jw Jwᵀ + e`` over the coefficients w, e their precision, and C the columns of the other unknowns q,
        the information on q is ``e Cᵀ M⁻¹ C`` (Schur complement). A displacement with gradient g by w and ``k = Jw g``
        has the variance ``(gᵀg - kᵀ M⁻¹ k) / e`` given q, plus a term from the uncertainty of q.
        """
        residuals, columns = self.residuals, self.linear.columns
        grams, matrix, first = [], torch.zeros_like(self.gram), 0
        for k, (block, ansatz, tape) in enumerate(
            zip(residuals.blocks, residuals.ansatzes, self.state.tapes, strict=True)
        ):
            extra, points = self.displacements(k)
            both = [torch.cat(pair, 2) for pair in zip(self.linear.adjoints[k], extra, strict=True)]
            grams.append(ansatz.gram(tape, both, torch.cat([block.points, points])))
            rows = slice(first, first + block.n_rows)
            matrix[:, rows, rows] = grams[k][:, : block.n_rows, : block.n_rows]
            first += block.n_rows
        precision = PRECISION * matrix.diagonal(dim1=1, dim2=2).amax(1)
        factor = torch.linalg.cholesky(_damped(matrix, precision))
        solved = torch.cholesky_solve(columns, factor)
        covariance = inverse(precision[:, None, None] * (columns.mT @ solved))
        variances, first = [], 0
        for block, gram in zip(residuals.blocks, grams, strict=True):
            n = block.n_rows
            cross = gram.new_zeros(residuals.n_fits, residuals.n_rows, gram.shape[1] - n)
            cross[:, first : first + n] = gram[:, :n, n:]
            inner = (cross * torch.cholesky_solve(cross, factor)).sum(1)
            given = (gram[:, n:, n:].diagonal(dim1=1, dim2=2) - inner) / precision[:, None]
            by_unknowns = cross.mT @ solved
            variances.append(given + ((by_unknowns @ covariance) * by_unknowns).sum(2))
            first += n
        return LaplacePosterior(covariance, variances)


class PrimalEquations(NormalEquations):
    """The equations in the space of the unknowns, accumulated from blocks of J."""

    def __init__(self, residuals: Residuals, state: State, deviations: Tensor) -> None:
        super().__init__(residuals, state, deviations)
        self.matrix = state.z.new_zeros(residuals.n_fits, residuals.n_z, residuals.n_z)
        self.gradient, self.size = torch.zeros_like(state.z), state.z.new_zeros(residuals.n_fits)
        for rows, j in residuals.jacobian_parts(state, self.linear):
            self.matrix += j.mT @ j
            self.gradient += (state.rows[:, None, rows] @ j)[:, 0]
            if j.shape[1]:
                self.size = torch.maximum(self.size, (j * j).sum(2).amax(1))
        self.trace = self.matrix.diagonal(dim1=1, dim2=2).sum(1)

    def solve(self, damping: Tensor) -> tuple[Tensor, Tensor]:
        # the predicted decrease is ``hᵀ (μ h + Jᵀ r) / 2`` for the step h
        factor, info = torch.linalg.cholesky_ex(_damped(self.matrix, damping))
        step = torch.cholesky_solve(self.gradient[..., None], factor)[..., 0]
        decrease = 0.5 * (step * (damping[:, None] * step + self.gradient)).sum(1)
        return step, torch.where(info == 0, decrease, torch.nan)

    def posterior(self) -> LaplacePosterior:
        n_w = self.residuals.n_coefficients
        matrix = self.matrix.clone()
        matrix.diagonal(dim1=1, dim2=2)[:, :n_w] += PRECISION * self.size[:, None]
        covariance = inverse(matrix)
        variances, first = [], 0
        for k, (ansatz, tape) in enumerate(zip(self.residuals.ansatzes, self.state.tapes, strict=True)):
            g = ansatz.jacobian(tape, *self.displacements(k))
            part = slice(first, first + ansatz.count)
            variances.append(((g @ covariance[:, part, part]) * g).sum(2))
            first += ansatz.count
        return LaplacePosterior(covariance[:, n_w:, n_w:], variances)


class BandedEquations(NormalEquations):
    """The banded equations of splines and windows; work and memory are proportional to the record's length.

    A row depends on the few functions that are non-zero at its point. The other unknowns are eliminated by their Schur
    complement (C. de Boor, A Practical Guide to Splines, chapter XIV; G. Golub and C. Van Loan, Matrix Computations,
    4th edition, section 4.3). The coefficients of each record are ordered by time: the first function of all paths,
    then the second, and so on. The fits are solved one by one with NumPy and LAPACK.
    """

    def __init__(self, residuals: Residuals, state: State, deviations: Tensor) -> None:
        super().__init__(residuals, state, deviations)
        self.order, start = [], 0
        for ansatz in residuals.ansatzes:
            assert isinstance(ansatz, Local)
            self.order.append(start + np.arange(ansatz.count).reshape(ansatz.n_paths, -1).T.ravel())
            start += ansatz.count
        points = [block.points for block in residuals.blocks]
        rows = self._local_rows(range(len(points)), self.linear.adjoints, points)
        columns = torch.cat([self.linear.columns, state.rows[..., None]], 2).cpu().numpy()
        self.bands = [of_fit.band() for of_fit in rows]
        self.borders = [part.sparse().T @ border[: part.first.size] for part, border in zip(rows, columns, strict=True)]
        self.corners = columns.transpose(0, 2, 1) @ columns
        squares = np.sum(columns[..., :-1] ** 2, 2)
        squares[:, : rows[0].first.size] += np.array([np.sum(of_fit.slopes**2, 1) for of_fit in rows])
        self.size = torch.as_tensor(squares.max(1), device=residuals.device)
        self.trace = torch.as_tensor(squares.sum(1), device=residuals.device)

    def _local_rows(
        self, records: Iterable[int], adjoints: Sequence[Adjoints], points: Sequence[Tensor]
    ) -> list[LocalRows]:
        """Return the rows of each fit at points of some records."""
        slopes, first = [], []
        for k, adjoint, where in zip(records, adjoints, points, strict=True):
            ansatz = self.residuals.ansatzes[k]
            assert isinstance(ansatz, Local)
            slopes.append(ansatz.slopes(adjoint[0], where).transpose(2, 3).flatten(2))
            first.append(int(self.order[k][0]) + ansatz.first[:, where] * ansatz.n_paths)
        pairs = zip(torch.cat(first, 1).cpu().numpy(), torch.cat(slopes, 1).cpu().numpy(), strict=True)
        return [LocalRows(*pair, self.residuals.n_coefficients) for pair in pairs]

    def _eliminate(self, i: int, damping: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Eliminate the coefficients of fit i, with a damping added to their diagonal.

        Returns:
            The band's Cholesky factor, its solutions for the border (n, n_unknowns + 1), the right-hand side last, and
            the Schur complement of the other unknowns.

        Raises:
            LinAlgError: Where the band is not positive definite.
        """
        damped = self.bands[i].copy()
        damped[0] += damping
        factor = cholesky_banded(damped, lower=True, check_finite=False)
        solved = cho_solve_banded((factor, True), self.borders[i], check_finite=False)
        return factor, solved, self.corners[i] - self.borders[i].T @ solved

    def solve(self, damping: Tensor) -> tuple[Tensor, Tensor]:
        order, q = np.concatenate(self.order), self.residuals.n_unknowns
        steps = np.full(self.state.z.shape, np.nan)
        gradients = np.empty_like(steps)
        for i, mu in enumerate(damping.tolist()):
            gradients[i] = np.concatenate([self.borders[i][np.argsort(order), q], self.corners[i, :q, q]])
            try:
                _, solved, corner = self._eliminate(i, mu)
                unknowns = cho_solve(cho_factor(corner[:q, :q] + mu * np.eye(q)), corner[:q, q]) if q else np.zeros(0)
            except (LinAlgError, ValueError):
                continue
            steps[i, order] = solved[:, q] - solved[:, :q] @ unknowns
            steps[i, order.size :] = unknowns
        decreases = 0.5 * np.sum(steps * (damping.cpu().numpy()[:, None] * steps + gradients), 1)
        device = self.residuals.device
        return torch.as_tensor(steps, device=device), torch.as_tensor(decreases, device=device)

    def posterior(self) -> LaplacePosterior:
        q = self.residuals.n_unknowns
        fits = [self._eliminate(i, PRECISION * float(size)) for i, size in enumerate(self.size)]
        covariance = inverse(torch.as_tensor(np.array([corner[:q, :q] for *_, corner in fits])))
        inverses = [inverse_band(factor) for factor, _, _ in fits]
        variances = []
        for k in range(len(self.residuals.blocks)):
            adjoints, points = self.displacements(k)
            of_fits = []
            for i, rows in enumerate(self._local_rows([k], [adjoints], [points])):
                by_unknowns = rows.sparse() @ fits[i][1][:, :q]
                added = np.sum((by_unknowns @ covariance[i].numpy()) * by_unknowns, 1)
                of_fits.append(rows.quadratic(inverses[i]) + added)
            variances.append(torch.as_tensor(np.array(of_fits), device=self.residuals.device))
        return LaplacePosterior(covariance.to(self.residuals.device), variances)


@dataclass(frozen=True)
class LocalRows:
    """Rows of J (n_rows, k) by the k consecutive coefficients from index ``first`` (n_rows,) on, of ``n``."""

    first: np.ndarray
    slopes: np.ndarray
    n: int

    def _pairs(self) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """Yield the offset of a diagonal, column indices (n_rows,), and products of slopes, for all pairs."""
        k = self.slopes.shape[1]
        for below in range(k):
            for a in range(k - below):
                yield below, self.first + a, self.slopes[:, a] * self.slopes[:, a + below]

    def band(self) -> np.ndarray:
        """Return the lower diagonals of JᵀJ, (k, n)."""
        diagonals = np.zeros((self.slopes.shape[1], self.n))
        for below, places, products in self._pairs():
            diagonals[below] += np.bincount(places, products, self.n)
        return diagonals

    def quadratic(self, band: np.ndarray) -> np.ndarray:
        """Return the quadratic form of each row with a symmetric matrix, given its lower diagonals (k, n)."""
        total = np.zeros(self.first.size)
        for below, places, products in self._pairs():
            total += (2.0 if below else 1.0) * products * band[below, places]
        return total

    def sparse(self) -> csr_array:
        """Return the rows as a sparse matrix (n_rows, n)."""
        n_rows, k = self.slopes.shape
        places = self.first[:, None] + np.arange(k)
        return csr_array((self.slopes.ravel(), places.ravel(), np.arange(n_rows + 1) * k), shape=(n_rows, self.n))


def inverse_band(factor: np.ndarray) -> np.ndarray:
    """Return the lower diagonals (k, n) of the inverse of ``L Lᵀ``, given those of L.

    Each column follows from the k - 1 columns after it (K. Takahashi, J. Fagan and M. Chen, 8th PICA
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
