"""Functions that a residual may call, for each library that evaluates it.

:func:`array_ops` serves array libraries (NumPy, JAX, PyTorch), :func:`ops_from` others (CasADi). The library is passed
as an argument, so that the benchmark does not import it.
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
    """Collect the functions of a library.

    Args:
        library: Module or object with the functions of :class:`bench.Ops`.
        solve: Solver of a linear system, given rows of the matrix and components of the right-hand side.
        others: Functions with other names in the library, e.g. ``abs=casadi.fabs``.

    Returns:
        The functions.
    """
    return Ops(solve=solve, **{name: others[name] if name in others else getattr(library, name) for name in NAMES})


def array_ops(library: Any, broadcast: Callable[..., Sequence[Array]] | None = None, solved: Any = None) -> Ops:
    """Collect the functions of an array library; entries of linear systems may be arrays or numbers.

    Args:
        library: Module with the functions of :class:`bench.Ops`, ``stack`` and ``linalg.solve``.
        broadcast: Function that broadcasts arrays to one shape; by default ``library.broadcast_arrays``.
        solved: Solver of linear systems; by default ``library.linalg.solve``.

    Returns:
        The functions.
    """
    broadcast, solved = broadcast or library.broadcast_arrays, solved or library.linalg.solve

    def solve(matrix: Sequence[Sequence[Array]], rhs: Components) -> Components:
        entries, n = broadcast(*[entry for row in matrix for entry in row], *rhs), len(rhs)
        stacked = library.stack(entries[: n * n], -1).reshape(*entries[0].shape, n, n)
        solution = solved(stacked, library.stack(entries[n * n :], -1)[..., None])[..., 0]
        return [solution[..., i] for i in range(n)]

    return ops_from(library, solve)


def solved_or_nan(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve linear systems (..., n, n); the solution is NaN for singular matrices, without affecting the others."""
    if matrix.shape[-1] == 1:
        return np.asarray(right / matrix)
    try:
        return np.linalg.solve(matrix, right)
    except np.linalg.LinAlgError:
        singular = (np.linalg.det(matrix) == 0)[..., None, None]
        return np.where(singular, np.nan, np.linalg.solve(np.where(singular, np.eye(matrix.shape[-1]), matrix), right))


numpy_ops = array_ops(np, solved=solved_or_nan)
"""NumPy functions for residuals; solutions are NaN if the mass matrix is singular."""
float_ops = ops_from(
    math,
    lambda matrix, rhs: np.linalg.solve(matrix, rhs).tolist(),
    abs=abs,
    where=lambda condition, a, b: a if condition else b,
)
"""Functions for residuals of plain numbers."""


@cache
def sympy_ops() -> Ops:
    """Return the functions of SymPy, which is imported on first use."""
    import sympy

    def solve(matrix: Sequence[Sequence[Any]], right: Sequence[Any]) -> list[Any]:
        return list(sympy.Matrix(matrix).LUsolve(sympy.Matrix(right)))

    return ops_from(sympy, solve, abs=sympy.Abs, where=lambda c, a, b: sympy.Piecewise((a, c), (b, True)))
