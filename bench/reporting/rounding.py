"""Numbers and names for reading: a value and its interval are rounded to what the interval says of the value."""

from __future__ import annotations

import math

LARGEST, SMALLEST = 1e6, 1e-4
"""What is as large as the first, or smaller than the second, is written with a power of ten."""
MEANINGFUL = 1e6
"""An excess of more says only that the estimate ran away, and how far is the optimiser's accident."""


def readable(name: str) -> str:
    """Return a quantity's name as tables show it: ``k/m``, ``damping ratio``."""
    return name.replace("_over_", "/").replace("_", " ")


def number(value: float) -> str:
    """Write three significant digits, or what stands for a number that is not there."""
    if math.isnan(value):
        return "-"
    if math.isinf(value):
        return "failed"
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.3e}"


def excess_text(value: float) -> str:
    """Write an excess: two decimals, three digits where it is large, no number where it says nothing."""
    if math.isnan(value):
        return "-"
    if value > MEANINGFUL:
        return f">{MEANINGFUL:.0e}".replace("e+0", "e")
    return f"{value:.2f}" if value < 10 else f"{value:.3g}"


def with_excess(value: float, excess: float) -> str:
    """Write a number, and behind it the excess where there is one."""
    return number(value) + (f" ×{excess_text(excess)}" if math.isfinite(excess) else "")


def percent(share: float, digits: int = 0) -> str:
    """Write a share in percent, without the sign."""
    return "-" if math.isnan(share) else f"{100 * share:.{digits}f}"


def percent_between(share: float, low: float, high: float, digits: int = 0) -> str:
    """Write the same with its interval."""
    return "-" if math.isnan(share) else f"{percent(share, digits)} ({percent(low, digits)} to {percent(high, digits)})"


def answered(n_ok: int, n: int) -> str:
    """Write how many fits gave an answer, of all."""
    return f"{n_ok}/{n}" if n else "not run"


def decimals(low: float, high: float) -> int | None:
    """Return the decimals of two significant digits of half the interval's width; None where it has no width or no end.

    They are negative where half the width is 100 or more. Two digits of an uncertainty are the usual rule (Guide to the
    Expression of Uncertainty in Measurement, JCGM 100:2008, 7.2.6).
    """
    half = 0.5 * (high - low)
    if not math.isfinite(half) or half <= 0:
        return None
    return 1 - int(f"{half:.1e}".partition("e")[2])  # 0.0996 is 0.10, so the exponent is that of the rounded number


def rounded(value: float, low: float, high: float) -> tuple[str, str, str]:
    """Write a value and the ends of its interval, all to the decimals that the interval's width decides.

    Where the interval has no width or no end each has three significant digits, or says why it has none.
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
