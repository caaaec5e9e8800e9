"""The tables of functions against the standard library's, and their linear systems against Cramer's rule."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from bench import Ops, array_ops, numpy_ops, ops_from
from bench.dynamics.ops import float_ops

LIBRARIES = ("floats", "numpy", "jax", "torch", "casadi", "sympy")


def table(name: str) -> tuple[Ops, Any]:
    """The table of a library as its users make it, and what makes a number its own."""
    if name in ("floats", "numpy"):
        return (float_ops, float) if name == "floats" else (numpy_ops, np.float64)
    library = pytest.importorskip(name)
    if name == "jax":
        library.config.update("jax_enable_x64", True)
        return array_ops(library.numpy), library.numpy.asarray
    if name == "torch":
        ops = array_ops(library, lambda *entries: library.broadcast_tensors(*map(library.as_tensor, entries)))
        return ops, lambda value: library.tensor(value, dtype=library.float64)

    def by_casadi(rows: Any, right: Any) -> Any:
        matrix = library.vertcat(*[library.horzcat(*row) for row in rows])
        return library.vertsplit(library.solve(matrix, library.vertcat(*right)))

    def by_sympy(rows: Any, right: Any) -> Any:
        return list(library.Matrix(rows).LUsolve(library.Matrix(right)))

    def cases(condition: Any, a: Any, b: Any) -> Any:
        return library.Piecewise((a, condition), (b, True))

    if name == "casadi":
        return ops_from(library, by_casadi, abs=library.fabs, where=library.if_else), library.DM
    return ops_from(library, by_sympy, abs=library.Abs, where=cases), library.Float


@pytest.mark.parametrize("name", LIBRARIES)
def test_the_functions_are_those_of_the_standard_library(name: str) -> None:
    ops, make = table(name)
    for value in (-1.3, 0.4):
        for function in ("sin", "cos", "tanh", "exp"):
            assert float(getattr(ops, function)(make(value))) == pytest.approx(
                getattr(math, function)(value), rel=1e-12
            )
        assert float(ops.abs(make(value))) == pytest.approx(abs(value))
        chosen = ops.where(make(value) > 0, make(2.0), make(3.0))
        assert float(chosen) == (2.0 if value > 0 else 3.0)


@pytest.mark.parametrize("name", LIBRARIES)
def test_a_linear_system_by_cramers_rule(name: str) -> None:
    ops, make = table(name)
    (a, b), (c, d), (e, f) = (2.0, 1.0), (-1.0, 3.0), (3.0, 5.0)
    x, y = ops.solve([[make(a), make(b)], [make(c), make(d)]], [make(e), make(f)])
    assert float(x) == pytest.approx((e * d - b * f) / (a * d - b * c))
    assert float(y) == pytest.approx((a * f - e * c) / (a * d - b * c))


@pytest.mark.parametrize("name", ["numpy", "jax", "torch"])
def test_entries_of_arrays_of_any_shape_and_numbers_together(name: str) -> None:
    ops, make = table(name)
    d = make([3.0, 4.0, 5.0])
    x, y = ops.solve([[2.0, 1.0], [0.0, d]], [make(4.0), 6.0])
    np.testing.assert_allclose(np.asarray(y), [2.0, 1.5, 1.2])
    np.testing.assert_allclose(np.asarray(x), [1.0, 1.25, 1.4])


def test_a_singular_matrix_spoils_its_own_set_only() -> None:
    matrix, rhs = [[2.0, 1.0], [4.0, np.array([2.0, 3.0])]], [3.0, 7.0]
    x, y = numpy_ops.solve(matrix, rhs)
    np.testing.assert_allclose(x, [np.nan, 1.0])
    np.testing.assert_allclose(y, [np.nan, 1.0])
