"""Quantities derived from a residual: regression columns, mass matrix, acceleration, state rate, state matrices.

Functions with an argument ``ops`` run in the library of their arguments, whose functions ``ops`` provides.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from bench.dynamics.ops import numpy_ops, solved_or_nan
from bench.systems import Array, Components, Ops, System

_analytic_ops = replace(numpy_ops, abs=lambda z: np.where(np.real(z) < 0, -z, z))
"""NumPy functions for residuals that are differentiated by an imaginary step."""


def mass_matrix(
    system: System, p: Mapping[str, Array], x: Components, v: Components, f: Components, z: Components, ops: Ops
) -> tuple[list[list[Array]], list[Array]]:
    """Compute the mass matrix M and the residual r0 without acceleration, so that ``r = M a + r0``.

    The matrix follows from unit accelerations, since a residual is affine in them; for a linear system, at rest, where
    a stiff spring causes no cancellation.

    Args:
        system: The system.
        p: Parameters by name.
        x: Displacement of each DOF (m).
        v: Velocity of each DOF (m/s).
        f: Force on each DOF (N).
        z: Hidden states.
        ops: Functions of the library of the arguments.

    Returns:
        Rows of M (n_dof by n_dof), and r0 (n_dof).
    """
    n = system.n_dof
    rest = system.residual(p, x, v, [0.0] * n, f, z, ops)
    if system.linear:
        still = [0.0] * n
        units = [[1.0 if i == j else 0.0 for i in range(n)] for j in range(n)]
        at_rest = [system.residual(p, still, still, unit, still, z, ops) for unit in units]
        return [[at_rest[j][i] for j in range(n)] for i in range(n)], rest
    columns = []
    for j in range(n):
        unit = [1.0 if i == j else 0.0 for i in range(n)]
        columns.append([r - r0 for r, r0 in zip(system.residual(p, x, v, unit, f, z, ops), rest, strict=True)])
    return [[columns[j][i] for j in range(n)] for i in range(n)], rest


def acceleration(
    system: System, p: Mapping[str, Array], x: Components, v: Components, f: Components, z: Components, ops: Ops
) -> Components:
    """Compute the acceleration at a state, the solution of ``M a = -r0``.

    Args:
        system: The system.
        p: Parameters by name.
        x: Displacement of each DOF (m).
        v: Velocity of each DOF (m/s).
        f: Force on each DOF (N).
        z: Hidden states.
        ops: Functions of the library of the arguments.

    Returns:
        Acceleration of each DOF (m/s²).
    """
    matrix, rest = mass_matrix(system, p, x, v, f, z, ops)
    if system.n_dof == 1:
        return [-rest[0] / matrix[0][0]]
    return ops.solve(matrix, [-r for r in rest])


def state_rate(system: System, p: Mapping[str, Array], state: Components, f: Components, ops: Ops) -> list[Array]:
    """Compute the time derivative of the state ``[x..., v..., z...]``.

    Args:
        system: The system.
        p: Parameters by name.
        state: Displacements (m), velocities (m/s) and hidden states.
        f: Force on each DOF (N).
        ops: Functions of the library of the arguments.

    Returns:
        Derivative of each component.
    """
    n = system.n_dof
    x, v, z = state[:n], state[n : 2 * n], state[2 * n :]
    return [*v, *acceleration(system, p, x, v, f, z, ops), *system.hidden_rates(p, x, v, f, z, ops)]


def regression_columns(
    system: System, x: Components, v: Components, a: Components, f: Components
) -> tuple[np.ndarray, np.ndarray]:
    """Compute A and b with ``residual = A @ p + b``, by unit parameter vectors.

    Args:
        system: System whose residual is affine in the parameters.
        x: Displacement (m), one array of shape (n,) per DOF.
        v: Velocity (m/s), likewise.
        a: Acceleration (m/s²), likewise.
        f: Force (N), likewise.

    Returns:
        A of shape (n_dof * n, n_parameters) and b of shape (n_dof * n,), with rows DOF by DOF.

    Raises:
        ValueError: If the residual is not affine in the parameters.
    """
    if not system.affine_in_parameters or system.n_hidden:
        raise ValueError(f"the residual of {system.name} has no regression columns: it is not affine in its parameters")
    shape = np.shape(x[0])

    def stacked(p: Mapping[str, float]) -> np.ndarray:
        rows = system.residual(p, x, v, a, f, [], numpy_ops)
        return np.concatenate([np.broadcast_to(np.asarray(r, float), shape) for r in rows])

    zero = dict.fromkeys(system.names, 0.0)
    offset = stacked(zero)
    return np.stack([stacked({**zero, name: 1.0}) - offset for name in system.names], axis=1), offset


def _unit_residuals(system: System, p: Mapping[str, Any]) -> np.ndarray:
    """Evaluate the residual of a linear system at unit vectors of (x, v, a, f), shape (..., n, 4 n).

    No entry is a small difference of large numbers. Parameters may be complex, with an imaginary step.
    """
    if not system.linear:
        raise ValueError(f"{system.name} is not linear: it has no constant matrices")
    n = system.n_dof
    units = np.eye(4 * n)
    x, v, a, f = (list(units[i * n : (i + 1) * n]) for i in range(4))
    columns = {name: np.asarray(value)[..., None] for name, value in p.items()}
    sets = np.broadcast_shapes(*map(np.shape, columns.values()))[:-1]
    residuals = np.empty((*sets, n, 4 * n), complex if any(map(np.iscomplexobj, columns.values())) else float)
    for i, row in enumerate(system.residual(columns, x, v, a, f, [], _analytic_ops)):
        residuals[..., i, :] = row
    return residuals


def linear_matrices(system: System, p: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return mass, damping and stiffness matrices of a linear system, each of shape (..., n_dof, n_dof).

    Parameters may be arrays of one shape, which leads the result. Raises ValueError if the system is not linear.
    """
    stiffness, damping, mass, _ = np.split(_unit_residuals(system, p), 4, axis=-1)
    return mass, damping, stiffness


def state_matrix(system: System, p: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Compute the matrices of ``s' = A s + B f`` for the state ``s = [x, v]`` of a linear system.

    Args:
        system: A linear system with n degrees of freedom.
        p: Parameters by name, numbers or arrays of one shape ``sets``.

    Returns:
        ``A`` of shape (*sets, 2n, 2n) and ``B`` of shape (*sets, 2n, n); NaN if the mass matrix is singular.

    Raises:
        ValueError: If the system is not linear.
    """
    n = system.n_dof
    residuals = _unit_residuals(system, p)
    by_input = np.concatenate([residuals[..., : 2 * n], residuals[..., 3 * n :]], axis=-1)
    rates = np.zeros((*residuals.shape[:-2], 2 * n, 3 * n), residuals.dtype)
    rates[..., :n, n : 2 * n] = np.eye(n)
    rates[..., n:, :] = -solved_or_nan(residuals[..., 2 * n : 3 * n], by_input)
    return rates[..., : 2 * n], rates[..., 2 * n :]
