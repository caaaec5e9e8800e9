"""Parse the equations and quantities of a claim: arithmetic expressions only, so no other code can run."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np

from bench.dynamics.ops import numpy_ops
from bench.errors import InputError
from bench.systems import Dimension, Ops, Parameter, Quantity, System

OF_EQUATIONS: Mapping[str, Any] = {name: getattr(np, name) for name in ("sin", "cos", "tanh", "exp", "abs", "pi")}
FUNCTIONS = {**OF_EQUATIONS, "sqrt": np.sqrt, "log": np.log}
"""Functions of expressions; equations of motion are limited to those that all libraries provide."""
ALLOWED = (
    ast.Expression,
    ast.BinOp,
    ast.UnaryOp,
    ast.Call,
    ast.Name,
    ast.Load,
    ast.Constant,
    ast.operator,
    ast.unaryop,
)
Value = Callable[[Mapping[str, Any]], Any]


def expression(text: str, names: Sequence[str], field: str, functions: Mapping[str, Any] = FUNCTIONS) -> Value:
    """Parse an expression of names, numbers and functions.

    Args:
        text: The expression.
        names: Names of the variables.
        field: Field of the claim, for errors.
        functions: Functions and constants.

    Returns:
        A function of the values of the variables.

    Raises:
        InputError: For an unknown name, or any other syntax of Python.
    """
    try:
        tree = ast.parse(text.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise InputError(field, text, "an expression such as k/m or 0.5*cos(2*t)") from None
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and node.id not in (*names, *functions):
            raise InputError(field, text, f"{node.id} is unknown; known: {', '.join([*names, *functions])}")
        if not isinstance(node, ALLOWED) or (isinstance(node, ast.Constant) and type(node.value) not in (int, float)):
            raise InputError(field, text, "names, numbers, + - * / **, parentheses and functions only")
    powers = {id(node.right) for node in ast.walk(tree) if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow)}
    for node in ast.walk(tree):  # integers stay exact as small exponents; large ones could exhaust the memory
        if (
            isinstance(node, ast.Constant)
            and isinstance(node.value, int)
            and (id(node) not in powers or node.value > 99)
        ):
            node.value = float(node.value)
    code = compile(tree, field, "eval")

    def value(values: Mapping[str, Any]) -> Any:
        return eval(code, {"__builtins__": {}, **functions}, dict(values))  # arithmetic only, as checked above

    try:
        with np.errstate(all="ignore"):
            float(value({name: 1.2 + 0.01 * i for i, name in enumerate(names)}))
    except (TypeError, ValueError, ArithmeticError):
        raise InputError(field, text, "it has no value; functions are written as sin(x)") from None
    return value


@dataclass(frozen=True)
class EquationSystem(System):
    """Equations of motion as text, one per mass: ``m*x'' + c*x' + k*x = f``, or with ``x1''``, ``x2'`` and so on.

    The parameters of the system are the absolute values of the ``unknown`` ones; ``known`` parameters, and the signs of
    ``negative`` ones, are constants in the equations.
    """

    equations: tuple[str, ...]
    unknown: tuple[str, ...]
    known: tuple[tuple[str, float], ...] = ()
    negative: tuple[str, ...] = ()
    name: ClassVar[str] = "equation"

    def __post_init__(self) -> None:
        sides = [re.sub(r"\bx(\d*)'", r"v\1", re.sub(r"\bx(\d*)''", r"a\1", text)) for text in self.equations]
        texts = [f"({left})-({right})" if equal else left for left, equal, right in (s.partition("=") for s in sides)]
        symbols, n = [*self.unknown, *dict(self.known)], len(texts)
        motion = [f"{letter}{i + 1 if n > 1 else ''}" for letter in "xvaf" for i in range(n)]
        for symbol in symbols:
            if symbol in (*FUNCTIONS, *motion) or not symbol.isidentifier():
                raise InputError("parameters", symbol, "a name that is not a motion, force or function")
        for acceleration in motion[2 * n : 3 * n]:
            if not re.search(rf"\b{acceleration}\b", " ".join(texts)):
                missing = f"{acceleration.replace('a', 'x')}''"
                raise InputError("equation", "; ".join(self.equations), f"it must contain {missing}")
        try:
            laws = [expression(text, [*motion, *symbols], "equation", OF_EQUATIONS) for text in texts]
        except InputError as error:  # in the notation of the claim: x'' instead of a
            written = [re.sub("^v(.*)", r"x\1'", re.sub("^a(.*)", r"x\1''", name)) for name in motion]
            remedy = error.remedy.replace(", ".join(motion), ", ".join(written))
            raise InputError("equation", "; ".join(self.equations), remedy) from None
        object.__setattr__(self, "_laws", (laws, motion))
        rng = np.random.default_rng(0)
        p, (a, b) = {symbol: rng.uniform(0.5, 1.5) for symbol in self.unknown}, rng.standard_normal((2, 4, n))
        with np.errstate(all="ignore"):
            first, second, both = (self.residual(p, m[0], m[1], m[2], m[3], [], numpy_ops) for m in (a, b, a + b))
            object.__setattr__(self, "linear", np.allclose(np.add(first, second), both, rtol=1e-9))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(Parameter(symbol, "", "other", Dimension()) for symbol in self.unknown)

    @property
    def n_dof(self) -> int:
        return len(self.equations)

    def residual(self, p, x, v, a, f, z, ops):  # type: ignore[no-untyped-def]
        laws, motion = self._laws  # type: ignore[attr-defined]
        functions = {field.name: getattr(ops, field.name) for field in fields(Ops)}
        signed = {name: -value if name in self.negative else value for name, value in p.items()}
        values = {**functions, **dict(self.known), **signed, **dict(zip(motion, [*x, *v, *a, *f], strict=True))}
        return [law(values) for law in laws]

    @property
    def groups(self) -> tuple[Quantity, ...]:
        return ()
