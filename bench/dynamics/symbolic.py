"""The functions that a residual may call, for sympy: equations as formulas."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

from bench.dynamics.ops import ops_from
from bench.systems import Ops


@cache
def sympy_ops() -> Ops:
    """The table of sympy, which is loaded when it is first asked for."""
    import sympy

    def solve(matrix: Sequence[Sequence[Any]], right: Sequence[Any]) -> list[Any]:
        return list(sympy.Matrix(matrix).LUsolve(sympy.Matrix(right)))

    return ops_from(sympy, solve, abs=sympy.Abs, where=lambda c, a, b: sympy.Piecewise((a, c), (b, True)))
