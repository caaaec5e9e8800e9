"""What methods found in a measured record, for reading in a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.reporting.answer import (
    MEANING,
    answer,
    ends_text,
    modes_table,
    parameters_table,
    residual_facts,
    runs_table,
    shapes_table,
    values_table,
)
from bench.reporting.rounding import number, readable
from bench.reporting.terminal import table, wrapped

FREE = "free vibration without a prior: m, c and k are not individually identifiable, only k/m and c/m"
OF_MODES = (
    "Intervals of this record: what its noise leaves open. Amplitude: at the first sample, where it is largest; share: "
    "root mean square over that of the signal; shape: over the largest, negative where opposed to it. m, c, k: of "
    "the mode, if the sensor is where the force acts."
)
WIDEST = 5
"""Columns of values that fit a terminal: the interval assuming white noise is in the JSON and in the certificate."""


def record_page(found: Mapping[str, Any], scale_is_free: bool) -> str:
    """Return one method's answer: values, verdict with its reasons, a table of intervals, and the residuals.

    ``found`` is what :class:`bench.Identification` holds, as plain values.
    """
    stated, withdrawn, residuals = found["estimates"], found["withdrawn"], found["residuals"]
    first = answer(stated, found["modes"]) + (" (95 % interval of a repeat)" if stated else "")
    head = [wrapped(first), wrapped(f"{found['method']}: {found['trust']}")]
    head += [wrapped(f"- {reason}", "    ", "  ") for reason in found["reasons"]]
    head.append(wrapped(f"record: {found['data']}, {found['samples']} samples"))
    head += [wrapped(f"note: {note}", "    ", "  ") for note in found["notes"]]
    blocks = ["\n".join(head)]
    if stated or withdrawn:
        values = values_table(stated, withdrawn)
        blocks.append(table([row[:WIDEST] for row in values.rows], values.headers[:WIDEST], (0, 2)))
    of_modes = (show(found["modes"]) for show in (modes_table, shapes_table, parameters_table))
    for grid in (*of_modes, runs_table(found["runs"])):
        if grid.rows:  # its first and last column hold words
            blocks.append(table(grid.rows, grid.headers, (0, len(grid.headers) - 1)))
    foot = [wrapped(f"Intervals {MEANING}.")] if stated else []
    foot += [wrapped(OF_MODES)] if any("amplitude" in mode for mode in found["modes"]) else []
    foot += [wrapped(FREE)] if scale_is_free and (stated or withdrawn) else []
    foot += [wrapped(f"{name}: {text}") for name, text in residual_facts(residuals).items()] if residuals else []
    return "\n\n".join([*blocks, *(["\n".join(foot)] if foot else [])])


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
