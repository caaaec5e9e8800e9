"""Rounding of stored numbers to five significant decimal digits, stored in the archive as seventeen binary digits."""

from __future__ import annotations

import numpy as np

DIGITS = 5
BITS = 17
"""Binary digits after the leading one that determine five decimal digits."""
SMALLEST, LARGEST = 1e-15, 1e20
"""Range in which the powers of ten needed for rounding are exact."""


def decimal(values: np.ndarray) -> np.ndarray:
    """Round numbers to five significant decimal digits."""
    size = np.abs(values)
    in_range = (size > SMALLEST) & (size < LARGEST)
    places = DIGITS - 1 - np.floor(np.log10(size, where=in_range, out=np.zeros_like(size))).astype(int)
    up, down = 10.0 ** np.maximum(places, 0), 10.0 ** np.maximum(-places, 0)
    scaled = np.where(in_range, values, 0.0) * up / down
    result = np.where(in_range, np.round(scaled) / up * down, values)
    for i in np.flatnonzero(~in_range & np.isfinite(values) & (values != 0)):
        result.flat[i] = float(f"{values.flat[i]:.{DIGITS}g}")
    return result


def binary(values: np.ndarray, bits: int = BITS) -> np.ndarray:
    """Round numbers to ``bits`` binary digits after the leading one."""
    mantissa, exponent = np.frexp(values)
    return np.asarray(np.ldexp(np.round(np.ldexp(mantissa, bits + 1)), exponent - bits - 1))
