"""Significant digits of stored numbers: six decimal ones, which the archive holds as twenty binary ones."""

from __future__ import annotations

import numpy as np

DIGITS = 6
BITS = 20
"""Binary digits behind the first that determine six decimal ones."""
SMALLEST, LARGEST = 1e-15, 1e20
"""Between these the powers of ten that round a number are exact."""


def decimal(values: np.ndarray) -> np.ndarray:
    """Round numbers to six significant decimal digits."""
    size = np.abs(values)
    usual = (size > SMALLEST) & (size < LARGEST)
    places = DIGITS - 1 - np.floor(np.log10(size, where=usual, out=np.zeros_like(size))).astype(int)
    up, down = 10.0 ** np.maximum(places, 0), 10.0 ** np.maximum(-places, 0)
    result = np.where(usual, np.round(values * up / down) / up * down, values)
    for i in np.flatnonzero(~usual & np.isfinite(values) & (values != 0)):
        result.flat[i] = float(f"{values.flat[i]:.{DIGITS}g}")
    return result


def binary(values: np.ndarray, bits: int = BITS) -> np.ndarray:
    """Round numbers to so many binary digits behind the first."""
    mantissa, exponent = np.frexp(values)
    return np.asarray(np.ldexp(np.round(np.ldexp(mantissa, bits + 1)), exponent - bits - 1))
