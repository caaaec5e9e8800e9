"""Truncated Taylor series in time with exact rational coefficients and their gradients.

A residual written in plain operators runs on :class:`Series` as it runs on arrays. Each coefficient carries its exact
derivatives by the unknowns (forward mode; Griewank and Walther, Evaluating Derivatives, SIAM 2008, chapters 3 and 13),
so that a rank found from them is a rank, not a guess about rounding.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from bench.systems import Ops

LARGEST = 40
"""Random points have integer coordinates up to this: generic enough, and short in exact arithmetic."""


def rational(value: Any) -> Any:
    """Return an exact rational number (sympy's QQ) from an int, a float (its exact binary value) or a rational."""
    from sympy import QQ

    if isinstance(value, float | np.floating):
        fraction = Fraction(float(value))
        return QQ(fraction.numerator, fraction.denominator)
    return QQ(int(value)) if isinstance(value, int | np.integer) else value


class Series:
    """``sum_k c[k, 0] t^k`` with gradients ``c[k, 1:]`` by the unknowns; ``c``: objects (length, 1 + n_unknowns).

    A series of length 1 is a constant in time. All others of one calculation have one length, where they are cut off.
    """

    __slots__ = ("c",)
    __array_ufunc__ = None  # a numpy scalar on the left leaves the operation to this class

    def __init__(self, c: np.ndarray) -> None:
        self.c = c

    @classmethod
    def constant(cls, value: Any, n: int, unknown: int | None = None, slope: Any = 1) -> Series:
        """Make a constant among ``n`` unknowns; with ``unknown`` given it has the derivative ``slope`` by that one."""
        c = np.full((1, 1 + n), rational(0), dtype=object)
        c[0, 0] = rational(value)
        if unknown is not None:
            c[0, 1 + unknown] = rational(slope)
        return cls(c)

    def _other(self, other: Any) -> Series:
        return other if isinstance(other, Series) else Series.constant(other, self.c.shape[1] - 1)

    def __add__(self, other: Any) -> Series:
        a, b = self.c, self._other(other).c
        if len(a) < len(b):
            a, b = b, a
        total = a.copy()
        total[: len(b)] += b
        return Series(total)

    __radd__ = __add__

    def __neg__(self) -> Series:
        return Series(-self.c)

    def __sub__(self, other: Any) -> Series:
        return self + (-self._other(other))

    def __rsub__(self, other: Any) -> Series:
        return (-self) + other

    def __mul__(self, other: Any) -> Series:
        a, b = self.c, self._other(other).c
        if len(a) > len(b):
            a, b = b, a
        product = _times(a[0], b)
        for i in range(1, len(a)):
            product[i:] += _times(a[i], b[: len(b) - i])
        return Series(product)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Series:
        a, b = self.c, self._other(other).c
        inverse = _inverse(b[0])
        length = max(len(a), len(b))
        quotient = np.full((length, a.shape[1]), rational(0), dtype=object)
        quotient[: len(a)] = a
        for k in range(length):
            for i in range(1, min(k, len(b) - 1) + 1):
                quotient[k] -= _times(b[i], quotient[k - i])
            quotient[k] = _times(inverse, quotient[k])
        return Series(quotient)

    def __rtruediv__(self, other: Any) -> Series:
        return self._other(other) / self

    def __pow__(self, power: Any) -> Series:
        if power != int(power):
            raise TypeError(f"only whole powers have exact series, not {power}")
        result = self._other(1)
        for _ in range(abs(int(power))):
            result = result * self
        return result if power >= 0 else 1 / result

    def __gt__(self, other: Any) -> bool:
        return _sign((self - other).c[0, 0]) > 0

    def __lt__(self, other: Any) -> bool:
        return _sign((self - other).c[0, 0]) < 0

    __ge__, __le__ = __gt__, __lt__


def _times(row: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Multiply one coefficient by others, by the product rule: (1 + n,) times (..., 1 + n)."""
    product = np.asarray(row[0] * rows)
    product[..., 1:] += rows[..., :1] * row[1:]
    return product


def _inverse(row: np.ndarray) -> np.ndarray:
    value = 1 / row[0]
    inverse = -(value * value) * row
    inverse[0] = value
    return np.asarray(inverse)


def _sign(value: Any) -> int:
    """Return the side of a switch; raises ZeroDivisionError at the switch itself, where there is no Taylor series."""
    if value == 0:
        raise ZeroDivisionError("a function that switches has no Taylor series at the switch")
    return 1 if value > 0 else -1


def _absolute(u: Series) -> Series:
    """Return ``|u|`` just after time 0, by the sign of the first coefficient that is not zero for all parameters."""
    for row in u.c:
        if np.any(row != 0):
            return u * _sign(row[0])
    return u


def _solution(
    u: Series, first: Sequence[np.ndarray], rates: Callable[[Sequence[Series]], Sequence[Any]]
) -> list[Series]:
    """Return the functions h of u with ``dh/du = rates(h)`` and first coefficients ``first``, term by term."""
    h = [row[None] for row in first]
    for k in range(1, len(u.c)):
        inner = [u.c[i] * rational(i) for i in range(1, k + 1)]
        outer = [rate.c for rate in rates([Series(part) for part in h])]
        rows = [sum(_times(slope, c[k - i]) for i, slope in enumerate(inner, 1)) / rational(k) for c in outer]
        h = [np.concatenate([part, row[None]]) for part, row in zip(h, rows, strict=True)]
    return [Series(part) for part in h]


def series_ops(rng: random.Random) -> Ops:
    """Make the table of the functions of a residual on series.

    A transcendental function of a rational number is not rational. But generically it is algebraically independent of
    its argument (Ax, Annals of Mathematics 93:252, 1971), so a random rational value, the same for the same argument,
    serves as its value: on the unit circle for sine and cosine.
    """
    drawn: dict[tuple[str, Any], Any] = {}

    def generic(kind: str, u: Series) -> Any:
        fraction = rational(rng.randint(1, LARGEST)) / rational(rng.randint(LARGEST + 1, 2 * LARGEST))
        return drawn.setdefault((kind, u.c[0, 0]), rational(0) if u.c[0, 0] == 0 else fraction)

    def first(u: Series, value: Any, slope: Any) -> np.ndarray:
        row = np.asarray(u.c[0] * slope)
        row[0] = value
        return row

    def exp(u: Series) -> Series:
        value = 1 + generic("exp", u)
        return _solution(u, [first(u, value, value)], lambda h: h)[0]

    def tanh(u: Series) -> Series:
        value = generic("tanh", u)
        return _solution(u, [first(u, value, 1 - value * value)], lambda h: [1 - h[0] * h[0]])[0]

    def sine_and_cosine(u: Series) -> list[Series]:
        half = generic("half angle", u)
        s, c = 2 * half / (1 + half * half), (1 - half * half) / (1 + half * half)
        return _solution(u, [first(u, s, c), first(u, c, -s)], lambda h: [h[1], -h[0]])

    return Ops(
        sin=lambda u: sine_and_cosine(u)[0],
        cos=lambda u: sine_and_cosine(u)[1],
        tanh=tanh,
        exp=exp,
        abs=_absolute,
        where=lambda condition, a, b: a if condition else b,
        solve=_solve,
    )


def _solve(matrix: Sequence[Sequence[Any]], rhs: Sequence[Any]) -> list[Any]:
    """Solve by Gauss-Jordan elimination; the pivot is the first row whose leading entry is not zero at time 0."""
    rows = [[*row, right] for row, right in zip(matrix, rhs, strict=True)]
    n = len(rows)
    for j in range(n):
        pivot = next((i for i in range(j, n) if _at_start(rows[i][j]) != 0), None)
        if pivot is None:
            raise ZeroDivisionError("the mass matrix is singular")
        rows[j], rows[pivot] = rows[pivot], rows[j]
        rows[j] = [entry if _is_zero(entry) else entry / rows[j][j] for entry in rows[j]]
        for i in range(n):
            if i != j and not _is_zero(rows[i][j]):
                rows[i] = [a - rows[i][j] * b for a, b in zip(rows[i], rows[j], strict=True)]
    return [row[n] for row in rows]


def _at_start(entry: Any) -> Any:
    return entry.c[0, 0] if isinstance(entry, Series) else entry


def _is_zero(entry: Any) -> bool:
    return not np.any(entry.c != 0) if isinstance(entry, Series) else entry == 0
