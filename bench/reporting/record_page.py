"""What methods found in a measured record, for reading in a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.reporting.answer import MEANING, Rows, answer, ends_text, modes_table, runs_table, values_table
from bench.reporting.rounding import number, readable
from bench.reporting.terminal import table, wrapped

FREE = "free vibration without a prior: m, c and k are not individually identifiable, only k/m and c/m"
WIDEST = 5
"""Columns of values that fit a terminal: the interval assuming white noise is in the JSON and in the certificate."""


def record_page(found: Mapping[str, Any], scale_is_free: bool) -> str:
    """Return one method's answer: values, verdict with its reasons, a table of intervals, and the residuals.

    ``found`` is what :class:`bench.Identification` holds, as plain values.
    """
    stated = found["estimates"]
    first = answer(stated, found["modes"]) + (" (95 % interval of a repeat)" if stated else "")
    lines = [wrapped(first), wrapped(f"{found['method']}: {found['trust']}")]
    lines += [wrapped(f"- {reason}", "    ", "  ") for reason in found["reasons"]]
    lines.append(wrapped(f"record: {found['data']}, {found['samples']} samples"))
    lines += [wrapped(f"note: {note}", "    ", "  ") for note in found["notes"]]
    if stated or found["withdrawn"]:
        headers, rows = values_table(stated, found["withdrawn"])
        lines += ["", table([row[:WIDEST] for row in rows], headers[:WIDEST], (0, 2)), ""]
    if stated:
        lines.append(wrapped(f"Intervals {MEANING}."))
    if found["modes"]:
        lines += ["", _table(modes_table(found["modes"])), ""]
    if found["runs"]:
        lines += ["", _table(runs_table(found["runs"])), ""]
    if scale_is_free and (stated or found["withdrawn"]):
        lines.append(wrapped(FREE))
    r = found["residuals"]
    if r:
        size = f"residual RMS: {number(r['rms'])} {r['unit']} ({100 * r['part_of_signal']:.2g} % of signal RMS)"
        colour = f"lag-1 autocorrelation {r['lag1_autocorrelation']:.2f}, whiteness p = {r['whiteness']:.2g}"
        lines.append(wrapped(f"{size}, {colour}, offset {number(r['offset'])} {r['unit']}"))
    return "\n".join(lines)


def _table(rows: Rows) -> str:
    """Return a table for the terminal; its first and last column hold words."""
    headers, lines = rows
    return table(lines, headers, (0, len(headers) - 1))


def methods_page(found: Sequence[Mapping[str, Any]], names: Sequence[str]) -> str:
    """Return several methods side by side: the verdict of each, and the quantities that most of them determine."""
    rows = []
    for result in found:
        intervals = [result["estimates"].get(name) for name in names]
        cells = [ends_text(interval) if interval else "-" for interval in intervals]
        rows.append([result["method"], result["trust"], *cells, number(result["wall_s"])])
    headers = ["method", "verdict", *(f"{readable(name)}, 95 %" for name in names), "s"]
    doubted = [result for result in found if result["trust"] == "do not trust"]
    lines = [f"record: {found[0]['data']}", "", table(rows, headers, (0, 1)), *([""] if doubted else [])]
    lines += [wrapped(f"{result['method']}: {result['reasons'][0]}", "    ", "  ") for result in doubted]
    return "\n".join(lines)
