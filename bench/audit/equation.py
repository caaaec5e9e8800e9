"""Equations and quantities as a claim writes them: arithmetic of names, read without executing anything else."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np

from bench.dynamics.ops import numpy_ops
from bench.errors import InputError
from bench.systems import Dimension, Ops, Parameter, Quantity, System

OF_EQUATIONS: Mapping[str, Any] = {name: getattr(np, name) for name in ("sin", "cos", "tanh", "exp", "abs", "pi")}
FUNCTIONS = {**OF_EQUATIONS, "sqrt": np.sqrt, "log": np.log}
"""What an expression may call; in an equation of motion, which other libraries run too, what all of them have."""
ALLOWED = (
    ast.Expression, ast.BinOp, ast.UnaryOp, ast.Call, ast.Name, ast.Load, ast.Constant, ast.Add, ast.Sub, ast.Mult,
    ast.Div, ast.Pow, ast.USub, ast.UAdd,
)  # fmt: skip


def expression(
    text: str, names: Collection[str], field: str, functions: Mapping[str, Any] = FUNCTIONS
) -> Callable[[Mapping[str, Any]], Any]:
    """Read an expression of names, numbers and functions; returns its value by those of the names.

    Raises InputError for anything else that Python could execute, and for a name that is not known.
    """
    known = {*names, *functions}
    try:
        tree = ast.parse(text.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise InputError(field, text, "an expression such as k/m or 0.5*cos(2*t) is wanted") from None
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and node.id not in known:
            raise InputError(field, text, f"{node.id} is unknown; there are {', '.join(sorted(known))}")
        number = not isinstance(node, ast.Constant) or type(node.value) in (int, float)
        if not isinstance(node, ALLOWED) or not number or (isinstance(node, ast.Call) and node.keywords):
            raise InputError(field, text, "names, numbers, + - * / **, parentheses and functions only")
    powers = {id(node.right) for node in ast.walk(tree) if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow)}
    for node in ast.walk(tree):  # whole numbers stay exact as small powers; others would grow without end
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
    """Equations of motion as text, one a mass: ``m*x'' + c*x' + k*x = f``, or ``x1''``, ``x2'`` and so on.

    ``symbols`` are its parameters, whose dimensions play no part.
    """

    equations: tuple[str, ...]
    symbols: tuple[str, ...]
    name: ClassVar[str] = "equation"

    def __post_init__(self) -> None:
        sides = [re.sub(r"\bx(\d*)''", r"a\1", text) for text in self.equations]
        sides = [re.sub(r"\bx(\d*)'", r"v\1", text) for text in sides]
        texts = [f"({left})-({right})" if equal else left for left, equal, right in (s.partition("=") for s in sides)]
        n = len(texts)
        numbers = [""] if n == 1 else [str(i + 1) for i in range(n)]
        names = [f"{letter}{i}" for i in numbers for letter in "xvaf"]
        for symbol in self.symbols:
            if symbol in (*FUNCTIONS, *names) or not symbol.isidentifier():
                raise InputError("parameters", symbol, "a name that the motion, the force or a function does not have")
        laws = [expression(text, [*names, *self.symbols], "equation", OF_EQUATIONS) for text in texts]
        object.__setattr__(self, "_laws", laws)
        object.__setattr__(self, "_numbers", numbers)
        rng = np.random.default_rng(0)
        p = {symbol: rng.uniform(0.5, 1.5) for symbol in self.symbols}

        def at(motion: np.ndarray) -> np.ndarray:
            x, v, a, f = motion
            return np.array(self.residual(p, x, v, a, f, [], numpy_ops), float)

        first, second = rng.standard_normal((2, 4, n))
        with np.errstate(all="ignore"):
            object.__setattr__(self, "linear", np.allclose(at(first) + at(second), at(first + second), rtol=1e-9))
        object.__setattr__(self, "smooth", not any("abs(" in text for text in texts))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(Parameter(symbol, "", "other", Dimension()) for symbol in self.symbols)

    @property
    def n_dof(self) -> int:
        return len(self.equations)

    def residual(self, p, x, v, a, f, z, ops):  # type: ignore[no-untyped-def]
        values = {**{field.name: getattr(ops, field.name) for field in fields(Ops)}, **p}
        for letter, parts in zip("xvaf", (x, v, a, f), strict=True):
            values |= {f"{letter}{i}": part for i, part in zip(self._numbers, parts, strict=True)}  # type: ignore[attr-defined]
        return [law(values) for law in self._laws]  # type: ignore[attr-defined]

    @property
    def groups(self) -> tuple[Quantity, ...]:
        return ()


@dataclass(frozen=True)
class PartlyKnown(System):
    """A system of which some parameters are ``known`` numbers, and the others have a known ``sign``."""

    system: System
    known: tuple[tuple[str, float], ...]
    negative: tuple[str, ...]
    name: ClassVar[str] = "partly_known"

    def __post_init__(self) -> None:
        for declared in ("linear", "smooth"):
            object.__setattr__(self, declared, getattr(self.system, declared))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(p for p in self.system.parameters if p.name not in dict(self.known))

    @property
    def n_dof(self) -> int:
        return self.system.n_dof

    @property
    def n_hidden(self) -> int:
        return self.system.n_hidden

    def _all(self, p: Mapping[str, Any]) -> dict[str, Any]:
        return {**dict(self.known), **{name: -value if name in self.negative else value for name, value in p.items()}}

    def residual(self, p, x, v, a, f, z, ops):  # type: ignore[no-untyped-def]
        return self.system.residual(self._all(p), x, v, a, f, z, ops)

    def hidden_rates(self, p, x, v, f, z, ops):  # type: ignore[no-untyped-def]
        return self.system.hidden_rates(self._all(p), x, v, f, z, ops)

    @property
    def groups(self) -> tuple[Quantity, ...]:
        return ()
