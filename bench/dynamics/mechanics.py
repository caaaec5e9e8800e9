"""What follows from a residual alone: regression columns, mass matrix, acceleration, state rate, matrices.

Every function runs in whichever library its arguments come from; ``ops`` names that library's functions.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bench.dynamics.ops import numpy_ops
from bench.systems import Array, Components, Ops, System


def mass_matrix(
    system: System, p: Mapping[str, Array], x: Components, v: Components, f: Components, z: Components, ops: Ops
) -> tuple[list[list[Array]], list[Array]]:
    """Mass matrix rows M and the residual at rest of acceleration r0, so that ``r = M a + r0``.

    By unit accelerations, since a residual is affine in them (architecture rule: the physics is written once). Those of
    a linear system at rest, where no stiff spring takes digits of the difference.
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
    """The acceleration at a state: the solution of ``M a = -r0``, one component a DOF."""
    matrix, rest = mass_matrix(system, p, x, v, f, z, ops)
    if system.n_dof == 1:
        return [-rest[0] / matrix[0][0]]
    return ops.solve(matrix, [-r for r in rest])


def state_rate(system: System, p: Mapping[str, Array], state: Components, f: Components, ops: Ops) -> list[Array]:
    """Time derivative of the state ``[x..., v..., z...]``, component by component."""
    n = system.n_dof
    x, v, z = state[:n], state[n : 2 * n], state[2 * n :]
    return [*v, *acceleration(system, p, x, v, f, z, ops), *system.hidden_rates(p, x, v, f, z, ops)]


def regression_columns(
    system: System, x: Components, v: Components, a: Components, f: Components
) -> tuple[np.ndarray, np.ndarray]:
    """Columns A and offset b with ``residual = A @ p + b``, by unit parameter vectors.

    ``x``, ``v``, ``a``, ``f`` hold one array of shape (n,) a DOF. Returns A of shape (n_dof * n, n_parameters) and
    b of shape (n_dof * n,), rows DOF by DOF. Raises ValueError where the residual is not affine in the parameters.
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


def linear_matrices(system: System, p: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mass, damping and stiffness matrices of a linear system, each of shape (..., n_dof, n_dof).

    Parameters may be arrays of one shape, which leads the result. Raises ValueError where the system is not linear.
    """
    if not system.linear:
        raise ValueError(f"{system.name} is not linear: it has no constant matrices")
    n = system.n_dof
    shape = np.broadcast_shapes(*(np.shape(value) for value in p.values()))
    zero = [0.0] * n

    def matrix(which: int) -> np.ndarray:
        result = np.empty((*shape, n, n))
        for j in range(n):
            state = [list(zero), list(zero), list(zero)]
            state[which][j] = 1.0
            x, v, a = state
            for i, r in enumerate(system.residual(p, x, v, a, zero, [], numpy_ops)):
                result[..., i, j] = r
        return result

    return matrix(2), matrix(1), matrix(0)


def state_matrix(system: System, p: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """``A`` and ``B`` of ``s' = A s + B f`` for the state ``s = [x, v]``, shapes (..., 2n, 2n) and (..., 2n, n)."""
    n = system.n_dof
    mass, damping, stiffness = linear_matrices(system, p)
    inverse = 1.0 / mass if n == 1 else np.linalg.inv(mass)
    a = np.zeros((*mass.shape[:-2], 2 * n, 2 * n))
    a[..., :n, n:] = np.eye(n)
    a[..., n:, :n] = -inverse @ stiffness
    a[..., n:, n:] = -inverse @ damping
    b = np.zeros((*mass.shape[:-2], 2 * n, n))
    b[..., n:, :] = inverse
    return a, b
