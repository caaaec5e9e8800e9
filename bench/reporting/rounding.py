"""Numbers and names for reading; a value and its interval have the digits that the width of the interval supports."""

from __future__ import annotations

import math

LARGEST, SMALLEST = 1e6, 1e-4
"""Numbers from the first on, and below the second, are written with a power of ten."""
MOST_DIGITS = 6
"""Significant digits of a value at most, however narrow its interval."""
MEANINGFUL = 1e6
"""Largest excess that is written as a number; the size of a larger one depends on where the search was stopped."""


def readable(name: str) -> str:
    """Return a quantity's name as tables show it: ``k/m``, ``damping ratio``."""
    return name.replace("_over_", "/").replace("_", " ")


def number(value: float) -> str:
    """Write three significant digits; ``-`` for NaN, ``failed`` for infinity."""
    if math.isnan(value):
        return "-"
    if math.isinf(value):
        return "failed"
    return f"{value + 0.0:.3g}" if abs(value) < 1000 else f"{value:.3e}"  # adding zero: no -0


def excess_text(value: float) -> str:
    """Write an excess with two decimals, from 10 on with three digits, beyond :data:`MEANINGFUL` as that limit."""
    if math.isnan(value):
        return "-"
    if value > MEANINGFUL:
        return f">{MEANINGFUL:.0e}".replace("e+0", "e")
    return f"{value:.2f}" if value < 10 else f"{value:.3g}"


def short_excess(value: float) -> str:
    """Write an excess in few letters: from 1,000 on without a power of ten, unless it is huge."""
    return f"{value:.0f}" if 1000 <= value < 1e6 else excess_text(value)


def time_text(seconds: float) -> str:
    """Write a time of computation in the unit that suits it: ``15.8 ms``, ``2.31 s``."""
    if not math.isfinite(seconds):
        return "-"
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if seconds >= size:
            return f"{number(seconds / size)} {unit}"
    return f"{number(seconds / 1e-6)} µs"


def with_excess(value: float, excess: float) -> str:
    """Write a number, followed by the excess where there is one."""
    return number(value) + (f" ×{excess_text(excess)}" if math.isfinite(excess) else "")


def percent(share: float, digits: int = 0) -> str:
    """Write a share in percent, without the sign."""
    return "-" if math.isnan(share) else f"{100 * share:.{digits}f}"


def percent_between(share: float, low: float, high: float, digits: int = 0) -> str:
    """Write a share in percent with its interval."""
    return "-" if math.isnan(share) else f"{percent(share, digits)} ({percent(low, digits)} to {percent(high, digits)})"


def answered(n_ok: int, n: int) -> str:
    """Write the number of successful fits and of all."""
    return f"{n_ok}/{n}" if n else "not run"


def decimals(low: float, high: float) -> int | None:
    """Return the decimals of two significant digits of half the interval's width; None where it has no width or no end.

    They are negative where half the width is 100 or more. Two digits of an uncertainty are the usual rule (Guide to the
    Expression of Uncertainty in Measurement, JCGM 100:2008, 7.2.6). The ends have :data:`MOST_DIGITS` at most.
    """
    half = 0.5 * (high - low)
    if not math.isfinite(half) or half <= 0:
        return None
    # 0.0996 is 0.10 and 9999999.0 is 1e7, so the exponent is that of the rounded number
    exponent = int(f"{half:.1e}".partition("e")[2])
    largest = int(f"{max(abs(low), abs(high)):.{MOST_DIGITS - 1}e}".partition("e")[2])
    return min(1 - exponent, MOST_DIGITS - 1 - largest)


def rounded(value: float, low: float, high: float) -> tuple[str, str, str]:
    """Write a value and the ends of its interval with the decimals that the width of the interval supports.

    They have three significant digits where the interval has no width or no end.
    """
    places = decimals(low, high)
    if places is None:
        return number(value), number(low), number(high)
    largest = max(abs(part) for part in (value, low, high) if math.isfinite(part))

    def text(part: float) -> str:
        if not math.isfinite(part):
            return number(part)
        shown = round(part, places) + 0.0  # adding zero: no "-0.0"
        if SMALLEST <= largest < LARGEST:
            return f"{shown:.{max(places, 0)}f}"
        exponent = int(f"{shown:.16e}".partition("e")[2]) if shown else -places
        return f"{shown:.{max(exponent + places, 0)}e}"

    return text(value), text(low), text(high)
