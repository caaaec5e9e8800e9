"""Uncertainty from the linearisation at a minimum: covariance of the parameters, and of the displacement.

The ansatz' coefficients have next to no prior of their own, a precision that is tiny beside what data and physics say.
It leaves smooth changes of x(t) free; a network of this size could imitate anything between its collocation points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from methods.network.ansatz import Local
from methods.pinn.banded import BandedEquations, LocalRows, inverse_band
from methods.pinn.block import Block
from methods.pinn.residuals import Residuals, State

PRECISION = 1e-10
"""Precision of the coefficients, relative to the largest squared row of J."""

LEAST_INFORMATION = 1e-100
"""On an unknown, so that one that nothing depends on has a variance, a huge one."""
SINGULAR = 1e-14
"""The least eigenvalue of the scaled information over the largest that rounding leaves."""


@dataclass
class Laplace:
    """Covariance of the other unknowns (B, n_unknowns, n_unknowns), the coefficients profiled out; and the standard
    deviation of the displacement at the collocation points, (B, n_dof, collocation), record by record.
    """

    covariance: Tensor
    bands: list[Tensor]


def laplace(residuals: Residuals, state: State, deviations: Tensor) -> Laplace:
    """The Gauss-Newton approximation of the posterior at a state."""
    if all(ansatz.local for ansatz in residuals.ansatzes):
        covariance, variances = _banded(residuals, state, deviations)
    else:
        covariance, variances = (_dual if residuals.n_rows <= residuals.n_z else _primal)(residuals, state, deviations)
    bands = [
        own.clamp(min=0.0).sqrt().unflatten(1, (block.n_dof, -1))
        for own, block in zip(variances, residuals.blocks, strict=True)
    ]
    return Laplace(covariance, bands)


def _inverse(information: Tensor) -> Tensor:
    """Inverses (B, n, n) of information matrices, each unknown in its own unit.

    A combination of unknowns that nothing tells comes out with a large variance, never with none.
    """
    scale = information.diagonal(dim1=1, dim2=2).clamp(min=LEAST_INFORMATION).rsqrt()
    both = scale[:, :, None] * scale[:, None]
    values, axes = torch.linalg.eigh(information * both)
    values = values.clamp(min=SINGULAR * values[:, -1:])
    return (axes / values[:, None]) @ axes.mT * both


def _displacements(residuals: Residuals, block: Block) -> tuple[Tensor, Tensor]:
    """Seeds and points of rows that are the displacements at the collocation points, DOF by DOF."""
    n, m = block.n_dof, block.collocation
    points = torch.arange(m, device=residuals.device).repeat(n)
    seeds = torch.zeros(residuals.n_fits, 3, n * m, block.n_paths, dtype=torch.float64, device=residuals.device)
    seeds[:, 0, :, :n] = torch.eye(n, dtype=torch.float64, device=residuals.device).repeat_interleave(m, 0)
    return block.response_adjoint(seeds, points), points


def _dual(residuals: Residuals, state: State, deviations: Tensor) -> tuple[Tensor, list[Tensor]]:
    """In residual space, with ``M = Jw Jwᵀ + e`` over the coefficients w, e their precision, and C the columns of the
    other unknowns q: information on q ``e Cᵀ M⁻¹ C`` (Schur complement); for a displacement with gradient g by w and
    ``k = Jw g``, variance ``(gᵀg - kᵀ M⁻¹ k) / e`` given q, and what the uncertainty of q adds.
    """
    linear = residuals.linearise(state, deviations)
    parts, _ = residuals.split_flat(state.z)
    matrix = residuals.gram(state, linear, unknowns=False)
    precision = PRECISION * matrix.diagonal(dim1=1, dim2=2).amax(1)
    matrix.diagonal(dim1=1, dim2=2).add_(precision[:, None])
    factor = torch.linalg.cholesky(matrix)
    solved = torch.cholesky_solve(linear.columns, factor)
    information = precision[:, None, None] * (linear.columns.mT @ solved)
    covariance = _inverse(information)
    variances, at = [], 0
    for k, (block, ansatz, tape) in enumerate(zip(residuals.blocks, residuals.ansatzes, state.tapes, strict=True)):
        seeds, points = _displacements(residuals, block)
        extra = ansatz.adjoint(parts[k], tape, seeds, points)
        both = [torch.cat(pair, 2) for pair in zip(linear.adjoints[k], extra, strict=True)]
        gram = ansatz.gram(tape, both, torch.cat([block.points, points]))
        n = block.n_rows
        cross = gram.new_zeros(residuals.n_fits, residuals.n_rows, points.shape[0])
        cross[:, at : at + n] = gram[:, :n, n:]
        inner = (cross * torch.cholesky_solve(cross, factor)).sum(1)
        given = (gram[:, n:, n:].diagonal(dim1=1, dim2=2) - inner) / precision[:, None]
        by_unknowns = cross.mT @ solved
        variances.append(given + ((by_unknowns @ covariance) * by_unknowns).sum(2))
        at += n
    return covariance, variances


def _primal(residuals: Residuals, state: State, deviations: Tensor) -> tuple[Tensor, list[Tensor]]:
    """In the space of the unknowns: the inverse of JᵀJ, with the coefficients' precision added."""
    linear = residuals.linearise(state, deviations)
    parts, _ = residuals.split_flat(state.z)
    n_w = residuals.n_coefficients
    matrix, _, size = residuals.normal_equations(state, linear)
    matrix.diagonal(dim1=1, dim2=2)[:, :n_w] += PRECISION * size[:, None]
    whole = _inverse(matrix)
    variances, at = [], 0
    for k, (block, ansatz, tape) in enumerate(zip(residuals.blocks, residuals.ansatzes, state.tapes, strict=True)):
        seeds, points = _displacements(residuals, block)
        g = ansatz.jacobian(tape, ansatz.adjoint(parts[k], tape, seeds, points), points)
        own = whole[:, at : at + ansatz.count, at : at + ansatz.count]
        variances.append(((g @ own) * g).sum(2))
        at += ansatz.count
    return whole[:, n_w:, n_w:], variances


def _banded(residuals: Residuals, state: State, deviations: Tensor) -> tuple[Tensor, list[Tensor]]:
    """In the space of the unknowns, by the bands of splines; as :func:`_primal`."""
    normal = BandedEquations(residuals, state, deviations)
    n = residuals.n_unknowns
    parts, _ = residuals.split_flat(state.z)
    eliminated = [normal.eliminate(i, PRECISION * float(size)) for i, size in enumerate(normal.size)]
    corners = np.array([own.corner[:n, :n] for own in eliminated])
    covariance = _inverse(torch.as_tensor(corners, device=residuals.device))
    variances = []
    for k, (block, ansatz, tape) in enumerate(zip(residuals.blocks, residuals.ansatzes, state.tapes, strict=True)):
        assert isinstance(ansatz, Local)
        seeds, points = _displacements(residuals, block)
        adjoints = ansatz.adjoint(parts[k], tape, seeds, points)
        own = []
        for i, one in enumerate(eliminated):
            rows = LocalRows.of(ansatz, adjoints, points, i)
            by_unknowns = rows.times(one.solved[k][:, :n])
            added = np.sum((by_unknowns @ covariance[i].cpu().numpy()) * by_unknowns, 1)
            own.append(rows.quadratic(inverse_band(one.factors[k])) + added)
        variances.append(torch.as_tensor(np.array(own), device=residuals.device))
    return covariance, variances
