"""Arrays in single precision as small integers: smooth curves by their differences of some order, without any loss.

A curve is laid on a grid as fine as its largest value is known; on it, differences of order ``k`` are taken, which are
small where the curve is smooth. What smaller values have beyond the grid is kept apart (``finer``). All of it is
integers, so nothing depends on how a machine rounds.
"""

from __future__ import annotations

import numpy as np

BITS = 24
"""Of a mantissa in single precision."""
MOST_FINER = 30
ORDERS = 8
PLAIN = -1
"""The order of an array that is kept as it is."""


def taken(values: np.ndarray) -> tuple[int, int, int, np.ndarray, np.ndarray]:
    """Order, exponent of the grid, number of finer bits, differences, and what is finer, both (n,) of int32.

    The order is PLAIN, and the differences are the bits themselves, where that is no worse.
    """
    flat = np.ascontiguousarray(values, "f4").ravel()
    plain = (PLAIN, 0, 0, flat.view(np.int32), np.empty(0, np.int32))
    if (
        flat.size < 2 * ORDERS
        or not np.all(np.isfinite(flat))
        or not np.any(flat)
        or np.any(np.signbit(flat) & (flat == 0))
    ):
        return plain
    exponent = int(np.frexp(np.max(np.abs(flat)))[1]) - BITS
    grid = np.ldexp(flat.astype(float), -exponent)
    steps = np.rint(grid)
    rest = np.ldexp(grid - steps, MOST_FINER)
    if np.any(rest != np.rint(rest)):
        return plain
    finer = rest.astype(np.int64)
    shift = min((int(b) for b in range(MOST_FINER + 1) if not np.any(finer % 2**b)), key=lambda b: -b)
    found = steps.astype(np.int64)
    best, order = found, 0
    for k in range(1, ORDERS):
        found = np.diff(found, prepend=0)
        if _bits(found) < _bits(best):
            best, order = found, k
    if np.max(np.abs(best)) >= 2**31 or _bits(best) + _bits(finer >> shift) > BITS * flat.size:
        return plain
    return order, exponent, MOST_FINER - shift, _folded(best), (finer >> shift).astype(np.int32)


def restored(order: int, exponent: int, finer_bits: int, differences: np.ndarray, finer: np.ndarray) -> np.ndarray:
    """The values, flat, of which :func:`taken` made this."""
    if order == PLAIN:
        return np.asarray(differences, np.int32).view("f4")
    found = _unfolded(differences)
    for _ in range(order):
        found = np.cumsum(found)
    return np.ldexp(found + np.ldexp(np.asarray(finer, float), -finer_bits), exponent).astype("f4")


def _bits(numbers: np.ndarray) -> float:
    return float(np.sum(np.log2(1.0 + 2.0 * np.abs(numbers))))


def _folded(numbers: np.ndarray) -> np.ndarray:
    return np.where(numbers >= 0, 2 * numbers, -2 * numbers - 1).astype(np.int64).astype(np.uint32).view(np.int32)


def _unfolded(numbers: np.ndarray) -> np.ndarray:
    wide = np.asarray(numbers, np.int32).view(np.uint32).astype(np.int64)
    return np.where(wide % 2 == 0, wide // 2, -(wide // 2) - 1)
