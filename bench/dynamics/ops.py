"""Tables of the functions that a residual may call, one for each library that runs it.

Those of numpy and of plain numbers stand here. A table for another library is made from the library that is handed in,
by :func:`array_ops` where it works on arrays as numpy does (jax, torch), else by :func:`ops_from` (casadi, sympy): the
harness imports none of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from bench.systems import Array, Components, Ops

Solve = Callable[[Sequence[Sequence[Array]], Components], Components]
NAMES = tuple(field.name for field in fields(Ops) if field.name != "solve")


def ops_from(library: Any, solve: Solve, **others: Callable[..., Array]) -> Ops:
    """Make the table of a library.

    Args:
        library: what has the functions of :class:`bench.Ops` by their names there.
        solve: solves a linear system given by rows of the matrix and components of the right-hand side.
        others: functions that the library calls otherwise, e.g. ``abs=casadi.fabs``.
    """
    return Ops(solve=solve, **{name: others[name] if name in others else getattr(library, name) for name in NAMES})


def array_ops(library: Any, broadcast: Callable[..., Sequence[Array]] | None = None) -> Ops:
    """Make the table of a library of arrays, in whose linear systems every entry may be an array or a number.

    ``broadcast`` brings arrays to one shape where the library has no ``broadcast_arrays``.
    """
    broadcast = broadcast or library.broadcast_arrays

    def solve(matrix: Sequence[Sequence[Array]], rhs: Components) -> Components:
        entries, n = broadcast(*[entry for row in matrix for entry in row], *rhs), len(rhs)
        stacked = library.stack(entries[: n * n], -1).reshape(*entries[0].shape, n, n)
        solution = library.linalg.solve(stacked, library.stack(entries[n * n :], -1)[..., None])[..., 0]
        return [solution[..., i] for i in range(n)]

    return ops_from(library, solve)


numpy_ops = array_ops(np)
"""The numpy functions a residual may call."""


def _solve_or_nan(matrix: Sequence[Sequence[Array]], rhs: Components) -> Components:
    try:
        return numpy_ops.solve(matrix, rhs)
    except np.linalg.LinAlgError:
        n = len(rhs)
        entries = np.broadcast_arrays(*[entry for row in matrix for entry in row], *rhs)
        stacked = np.stack(entries[: n * n], -1).reshape(*entries[0].shape, n, n)
        good = np.abs(np.linalg.det(stacked)) > 0
        rows = [[np.where(good, entries[i * n + j], float(i == j)) for j in range(n)] for i in range(n)]
        return numpy_ops.solve(rows, [np.where(good, entry, np.nan) for entry in entries[n * n :]])


nan_ops = replace(numpy_ops, solve=_solve_or_nan)
"""``numpy_ops``, but NaN where a matrix is singular: one set of parameters that ran away does not stop the others."""
float_ops = ops_from(
    math,
    lambda matrix, rhs: np.linalg.solve(matrix, rhs).tolist(),
    abs=abs,
    where=lambda condition, a, b: a if condition else b,
)
"""The functions that a residual may call, for plain numbers."""
