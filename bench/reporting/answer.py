"""Results of a measured record as sentences and tables, for the terminal and the certificate.

The functions take plain values; intervals have the fields of :class:`bench.records.intervals.StatedInterval`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from bench.reporting.rounding import decimals, number, readable, rounded

Interval = Mapping[str, Any]


MOST_LISTED = 4
"""Largest number of modes in the first line of a result."""


class Grid(NamedTuple):
    """A table: headers, rows of text, and the style of each row, if any has one."""

    headers: Sequence[str]
    rows: Sequence[Sequence[str]]
    classes: Sequence[str] = ()


MEANING = "of a repeat: expected range of another test of the same system; of this record: uncertainty due to its noise"
"""Meaning of the two kinds of intervals."""


def in_shown_unit(name: str, interval: Interval) -> Interval:
    """Convert an interval to the printed unit: percent for a damping ratio, unchanged for others."""
    if not name.startswith("damping_ratio"):
        return interval
    return {key: 100.0 * end if isinstance(end, float) else end for key, end in interval.items()} | {"unit": "%"}


def ends_text(interval: Interval, of: str = "") -> str:
    """Format an interval: ``51.9 to 52.3``, or a limit; ``of`` is the prefix of the names of the ends."""
    if interval["limit"] and of != "white_":
        return limit_text(interval)
    _, low, high = rounded(interval["value"], interval[f"{of}low"], interval[f"{of}high"])
    return f"{low} to {high}"


def value_and_ends(interval: Interval | None, of: str = "") -> tuple[str, str]:
    """Format a value with as many digits as its interval justifies, and the interval; dashes without one."""
    if interval is None:
        return "–", "–"
    if math.isnan(interval["low"]):
        return number(interval["value"]), "–"
    value = rounded(interval["value"], interval[f"{of}low"], interval[f"{of}high"])[0]
    return "–" if interval["limit"] else value, ends_text(interval, of)


def limit_text(interval: Interval) -> str:
    """Format an interval with one finite end: ``at most 0.41``."""
    return f"{interval['limit']} {interval['high'] if interval['limit'] == 'at most' else interval['low']:.2g}"


def uncertain_text(interval: Interval) -> str:
    """Format a value as ``52.10 ± 0.20``, or with both ends if the interval is not symmetric."""
    value, low, high = (interval[end] for end in ("value", "low", "high"))
    text, places, half = rounded(value, low, high)[0], decimals(low, high), 0.5 * (high - low)
    if math.isnan(half):
        return f"{value + 0.0:.4g}"  # adding zero: no -0
    if places is None or "e" in text or round(abs(high + low - 2 * value) * 10.0**places) > 1:
        return f"{text} ({ends_text(interval)})"
    return f"{text} ± {half:.{max(places, 0)}f}"


def quantity_text(name: str, interval: Interval) -> str:
    """Format a quantity: ``k/m = 52.10 ± 0.20 1/s²``, or ``c/m at most 0.4 1/s``."""
    shown = in_shown_unit(name, interval)
    text = limit_text(shown) if shown["limit"] else f"= {uncertain_text(shown)}"
    return f"{readable(name)} {text} {shown['unit'].strip('-')}".rstrip()


def answer(intervals: Mapping[str, Interval], modes: Sequence[Mapping[str, Any]] = ()) -> str:
    """Return the result in one line: parameters if their scale is identifiable, else frequency, damping ratio, groups.

    Without intervals, the ``modes`` are the result, if there are any.
    """
    if not intervals:
        return _modes_text(modes) if modes else "no value can be stated"
    modal = [name for name in intervals if name.startswith(("natural_frequency", "damping_ratio"))]
    groups = [name for name in intervals if "_over_" in name and not (modal and name in ("k_over_m", "c_over_m"))]
    parameters = [name for name in intervals if "_over_" not in name and name not in modal]
    return ", ".join(quantity_text(name, intervals[name]) for name in parameters or [*modal, *groups])


def _modes_text(modes: Sequence[Mapping[str, Any]]) -> str:
    pairs = [list(map(uncertain_text, _mode_intervals(mode))) for mode in modes]
    if any(mode["alias"] for mode in modes):
        return f"{' or '.join(f'{frequency} Hz' for frequency, _ in pairs)}: indistinguishable at this sampling rate"
    if len(pairs) > MOST_LISTED:
        return f"{len(pairs)} modes from {pairs[0][0]} to {pairs[-1][0]} Hz"
    text = "; ".join(f"{frequency} Hz, damping ratio {ratio} %" for frequency, ratio in pairs)
    return f"{len(pairs)} modes: {text}" if len(pairs) > 1 else f"one mode: {text}"


def _mode_intervals(mode: Mapping[str, Any]) -> tuple[Interval, Interval]:
    """Return the intervals of frequency (Hz) and damping ratio (%) of a mode."""
    frequency, ratio = (
        {"value": mode[name], "low": mode[f"{name}_low"], "high": mode[f"{name}_high"], "limit": "", "unit": "Hz"}
        for name in ("frequency", "damping_ratio")
    )
    return frequency, in_shown_unit("damping_ratio", ratio)


def residual_facts(residuals: Mapping[str, Any]) -> dict[str, str]:
    """Return facts of the residuals, by name."""
    part = f"{100 * residuals['part_of_signal']:.2g} % of signal RMS"
    lag = f"lag-1 autocorrelation {residuals['lag1_autocorrelation']:.2f}"
    return {
        "Residual RMS": f"{number(residuals['rms'])} {residuals['unit']} ({part})",
        "Residual whiteness": f"p = {residuals['whiteness']:.2g}, {lag}",
        "Sensor offset": f"{number(residuals['offset'])} {residuals['unit']}",
    }


# ------------------------------------------------------------------------------------------------ tables


def values_table(stated: Mapping[str, Interval], withdrawn: Mapping[str, Interval]) -> Grid:
    """Tabulate values with their intervals, or rejected values without, since their intervals would mislead."""
    shown = {name: in_shown_unit(name, interval) for name, interval in (stated or withdrawn).items()}
    if not stated:
        values = [(readable(name), number(part["value"]), part["unit"].strip("-")) for name, part in shown.items()]
        return Grid(("Quantity", "Rejected value", "Unit"), values)
    rows = []
    for name, interval in shown.items():
        value, *ends = *value_and_ends(interval), ends_text(interval, "record_"), ends_text(interval, "white_")
        rows.append((readable(name), value, interval["unit"].strip("-"), *ends))
    headers = ("Quantity", "Value", "Unit", "95 % interval of a repeat", "Of this record", "White-noise interval")
    return Grid(headers, rows)


def modes_table(modes: Sequence[Mapping[str, Any]]) -> Grid:
    """Tabulate the modes of a record with their intervals, aliases, and amplitudes if they are known."""
    rows = []
    for mode in modes:
        share = "alias" if mode["alias"] else f"{100 * mode['share']:.0f} % of the signal"
        rows.append([*map(uncertain_text, _mode_intervals(mode)), share])
        if math.isfinite(mode.get("amplitude", math.nan)):
            rows[-1].append(_plus_minus(mode["amplitude"], mode["amplitude_high"] - mode["amplitude"]))
    sized = [mode["amplitude_unit"] for mode in modes if math.isfinite(mode.get("amplitude", math.nan))]
    units = ", ".join(filter(None, dict.fromkeys(sized)))
    headers = ("Mode (Hz), 95 %", "Damping ratio (%), 95 %", "Share", f"Amplitude{units and f' ({units})'}, 95 %")
    return Grid(headers if sized else headers[:-1], rows)


def shapes_table(modes: Sequence[Mapping[str, Any]]) -> Grid:
    """Tabulate mode shapes relative to the largest sensor, with a phase unless it is 0° or 180°."""
    shapes = {number(mode["frequency"]): mode["shape"] for mode in modes if mode.get("shape")}
    rows = []
    for frequency, shape in shapes.items():
        phases = [f" at {part['phase']:.0f}°" if part["phase"] else "" for part in shape]
        cells = [_plus_minus(part["ratio"], part["half"]) + phase for part, phase in zip(shape, phases, strict=True)]
        rows.append((frequency, *cells))
    return Grid(("Shape (Hz)", *(part["sensor"] for shape in list(shapes.values())[:1] for part in shape)), rows)


def parameters_table(modes: Sequence[Mapping[str, Any]]) -> Grid:
    """Tabulate mass, damping and stiffness of each mode, for a single sensor at the point of the force."""
    rows, headers = [], ["Mode (Hz)"]
    for mode in modes:
        if parameters := mode.get("parameters"):
            headers = ["Mode (Hz)", *(f"{part['name']} ({part['unit']}), 95 %" for part in parameters)]
            rows.append((number(mode["frequency"]), *(_plus_minus(part["value"], part["half"]) for part in parameters)))
    return Grid(headers, rows)


def _plus_minus(value: float, half: float) -> str:
    return uncertain_text({"value": value, "low": value - half, "high": value + half, "limit": ""}) if half else "1"


def runs_table(runs: Mapping[str, Mapping[str, Any]]) -> Grid:
    """Tabulate the estimates from each of several records, with their 95 % intervals."""
    names = list(next((run["estimates"] for run in runs.values() if run["estimates"]), {}))[:2]
    rows = []
    for name, run in runs.items():
        pairs = [value_and_ends(run["estimates"].get(quantity), "record_") for quantity in names]
        left_out = f"left out: {run['left_out']}" if run["left_out"] else ""
        rows.append((name, *(text for pair in pairs for text in pair), left_out))
    headers = [text for quantity in names for text in (readable(quantity), "95 % interval")]
    return Grid(("Single run", *headers, ""), rows)
