"""The answer of a measured record in a line: each quantity with an uncertainty, in units that an engineer reads."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bench.reporting.rounding import decimals, readable, rounded

Interval = Mapping[str, Any]
"""A :class:`bench.records.intervals.StatedInterval` as plain values."""
MEANING = "of a repeat: what another test of the same rig would give; of this record: what its noise leaves open"
"""What the two intervals are, in one line."""
ASYMMETRY = 0.3
"""Difference of the two half-widths over their mean up to which ``±`` states both."""


def in_shown_unit(name: str, interval: Interval) -> Interval:
    """Return an interval in the unit that is shown: a damping ratio in percent, all others as they are."""
    if not name.startswith("damping_ratio"):
        return interval
    return {key: 100.0 * end if isinstance(end, float) else end for key, end in interval.items()} | {"unit": "%"}


def unit_text(unit: str) -> str:
    """Return a unit; none for a pure number."""
    return "" if unit == "-" else unit


def ends_text(interval: Interval, of: str = "") -> str:
    """Return an interval as text: ``51.9 to 52.3``, or the limit that the data determine; ``of`` names the ends."""
    if interval["limit"] and of != "white_":
        return f"{interval['limit']} {limit_text(interval)}"
    _, low, high = rounded(interval["value"], interval[f"{of}low"], interval[f"{of}high"])
    return f"{low} to {high}"


def value_text(interval: Interval) -> str:
    """Return the value with as many digits as its interval justifies; a dash where only a limit is determined."""
    return "–" if interval["limit"] else rounded(interval["value"], interval["low"], interval["high"])[0]


def limit_text(interval: Interval) -> str:
    """Return the one end of an interval that the data determine, to two significant digits."""
    return f"{interval['high'] if interval['limit'] == 'at most' else interval['low']:.2g}"


def quantity_text(name: str, interval: Interval) -> str:
    """Return ``k/m = 52.1 ± 0.2 1/s²``, the ends where they are uneven, or ``c/m at most 0.4 1/s``."""
    shown = in_shown_unit(name, interval)
    unit = f" {shown['unit']}" if unit_text(shown["unit"]) else ""
    if shown["limit"]:
        return f"{readable(name)} {shown['limit']} {limit_text(shown)}{unit}"
    value, low, high = (shown[end] for end in ("value", "low", "high"))
    text, places, half = rounded(value, low, high)[0], decimals(low, high), 0.5 * (high - low)
    if places is None or "e" in text or abs(high + low - 2 * value) > ASYMMETRY * half:
        return f"{readable(name)} = {text}{unit} ({ends_text(shown)})"
    return f"{readable(name)} = {text} ± {half:.{max(places, 0)}f}{unit}"


def answer(intervals: Mapping[str, Interval]) -> str:
    """Return the answer: parameters where their scale is determined, else frequency, damping ratio and other groups."""
    modal = [name for name in intervals if name.startswith(("natural_frequency", "damping_ratio"))]
    groups = [name for name in intervals if "_over_" in name and not (modal and name in ("k_over_m", "c_over_m"))]
    parameters = [name for name in intervals if "_over_" not in name and name not in modal]
    return ", ".join(quantity_text(name, intervals[name]) for name in parameters or [*modal, *groups])
