"""Numbers of six significant digits as integers, in order: neighbouring numbers have neighbouring integers.

``code = (exponent + OFFSET) * 900000 + (mantissa - 100000) + 1`` of ``mantissa * 10 ** (exponent - 5)`` with a mantissa
of six digits; negative numbers have negative codes, zero has 0. So a prediction that is nearly right leaves a small
difference, and a small difference takes little room.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

DIGITS = 6
LEAST, SPAN = 10 ** (DIGITS - 1), 9 * 10 ** (DIGITS - 1)
OFFSET = 330
"""No double is below 10 ** -324."""
INFINITE, NAN, MISSING = 2**30, 2**30 + 1, 2**30 + 2
EXACT_POWER = 22
"""Powers of ten up to this one are doubles, so one multiplication or division rounds correctly."""


def to_codes(values: np.ndarray) -> np.ndarray:
    """Codes (int64) of the six-digit numbers nearest to some numbers, in the shape of these."""
    values = np.asarray(values, float)
    size = np.abs(values)
    plain = np.isfinite(values) & (size > 0)
    safe = np.where(plain, size, 1.0)
    exponent = np.floor(np.log10(safe)).astype(np.int64)
    mantissa = np.rint(_scaled(safe, DIGITS - 1 - exponent))
    for wrong, step in ((mantissa >= 10 * LEAST, 1), (mantissa < LEAST, -1)):
        exponent = exponent + step * wrong
        mantissa = np.where(wrong, np.rint(_scaled(safe, DIGITS - 1 - exponent)), mantissa)
    far = plain & ((np.abs(exponent) > EXACT_POWER - DIGITS) | (mantissa < LEAST) | (mantissa >= 10 * LEAST))
    for i in np.flatnonzero(far):
        digits, _, power = f"{safe.flat[i]:.{DIGITS - 1}e}".partition("e")
        mantissa.flat[i], exponent.flat[i] = round(float(digits) * LEAST), int(power)
    codes = (exponent + OFFSET) * SPAN + (mantissa.astype(np.int64) - LEAST) + 1
    codes = np.where(plain, np.where(values < 0, -codes, codes), 0)
    codes = np.where(np.isinf(values), np.where(values > 0, INFINITE, -INFINITE), codes)
    return np.where(np.isnan(values), NAN, codes)


def from_codes(codes: np.ndarray) -> np.ndarray:
    """The numbers of some codes: the doubles nearest to their six digits; NaN for a missing one."""
    codes = np.asarray(codes, np.int64)
    size = np.abs(codes)
    plain = (size > 0) & (size < INFINITE)
    exponent, mantissa = np.divmod(np.where(plain, size - 1, OFFSET * SPAN), SPAN)
    exponent, mantissa = exponent - OFFSET - (DIGITS - 1), (mantissa + LEAST).astype(float)
    values = np.where(plain, _scaled(mantissa, exponent), 0.0)
    for i in np.flatnonzero(plain & (np.abs(exponent) > EXACT_POWER)):
        values.flat[i] = float(f"{int(mantissa.flat[i])}e{int(exponent.flat[i])}")
    values = np.where(codes < 0, -values, values)
    values = np.where(size == INFINITE, np.where(codes < 0, -math.inf, math.inf), values)
    return np.where(size > INFINITE, math.nan, values)


def listed(values: Sequence[float | None]) -> np.ndarray:
    """Codes of numbers of which some may be missing; raises ValueError where one has more than six digits."""
    numbers = np.array([math.nan if value is None else value for value in values], float)
    codes = to_codes(numbers)
    if not np.array_equal(from_codes(codes), numbers, equal_nan=True):
        raise ValueError("a number of more than six digits")
    codes[[i for i, value in enumerate(values) if value is None]] = MISSING
    return codes


_POWERS = 10.0 ** np.arange(EXACT_POWER + 1)


def _scaled(values: np.ndarray, powers: np.ndarray) -> np.ndarray:
    """Times a power of ten; right to the last digit where the power is an exact double."""
    size = np.minimum(np.abs(powers), EXACT_POWER)
    with np.errstate(over="ignore"):  # of numbers that the caller computes in another way
        return np.where(powers >= 0, values * _POWERS[size], values / _POWERS[size])
