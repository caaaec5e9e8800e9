"""Tables of the functions that a residual may call, one for each library that runs it.

A table for another library is made from the library that is handed in, by :func:`array_ops` where it works on arrays as
numpy does (jax, torch), else by :func:`ops_from` (casadi): the harness imports none of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import fields
from functools import cache
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


def array_ops(library: Any, broadcast: Callable[..., Sequence[Array]] | None = None, solved: Any = None) -> Ops:
    """Make the table of a library of arrays, in whose linear systems every entry may be an array or a number.

    ``broadcast`` brings arrays to one shape where the library has no ``broadcast_arrays``; ``solved`` replaces its
    ``linalg.solve``.
    """
    broadcast, solved = broadcast or library.broadcast_arrays, solved or library.linalg.solve

    def solve(matrix: Sequence[Sequence[Array]], rhs: Components) -> Components:
        entries, n = broadcast(*[entry for row in matrix for entry in row], *rhs), len(rhs)
        stacked = library.stack(entries[: n * n], -1).reshape(*entries[0].shape, n, n)
        solution = solved(stacked, library.stack(entries[n * n :], -1)[..., None])[..., 0]
        return [solution[..., i] for i in range(n)]

    return ops_from(library, solve)


def solved_or_nan(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve linear systems (..., n, n), NaN where a matrix is singular: one of them does not stop the others."""
    if matrix.shape[-1] == 1:
        return np.asarray(right / matrix)
    try:
        return np.linalg.solve(matrix, right)
    except np.linalg.LinAlgError:
        singular = (np.linalg.det(matrix) == 0)[..., None, None]
        return np.where(singular, np.nan, np.linalg.solve(np.where(singular, np.eye(matrix.shape[-1]), matrix), right))


numpy_ops = array_ops(np, solved=solved_or_nan)
"""The numpy functions a residual may call; NaN where a mass matrix is singular."""
float_ops = ops_from(
    math,
    lambda matrix, rhs: np.linalg.solve(matrix, rhs).tolist(),
    abs=abs,
    where=lambda condition, a, b: a if condition else b,
)
"""The functions that a residual may call, for plain numbers."""


@cache
def sympy_ops() -> Ops:
    """Make the table of sympy, which is loaded when it is first asked for: equations as formulas."""
    import sympy

    def solve(matrix: Sequence[Sequence[Any]], right: Sequence[Any]) -> list[Any]:
        return list(sympy.Matrix(matrix).LUsolve(sympy.Matrix(right)))

    return ops_from(sympy, solve, abs=sympy.Abs, where=lambda c, a, b: sympy.Piecewise((a, c), (b, True)))
