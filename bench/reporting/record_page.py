"""The results of methods on a measured record, for reading in a terminal."""

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
from bench.reporting.frame import group
from bench.reporting.rounding import readable, time_text
from bench.reporting.terminal import table, wrapped

FREE = "free vibration without a prior: m, c and k are not individually identifiable, only k/m and c/m"
MODES = (
    "Intervals of this record: uncertainty due to its noise. Amplitude: at the first sample, where it is largest; "
    "share: root mean square over that of the signal; shape: relative to the largest, negative in opposite phase. "
    "m, c, k: modal parameters, if the sensor is where the force acts."
)
NOISE_FREE = 1e-6
"""Residual RMS over signal RMS below which a record is practically free of noise."""
NO_ESTIMATE = {
    "unsupported": "not applicable", "missing_dependency": "not installed", "ok": "do not trust",
}  # fmt: skip
"""The heading of the methods without a trusted estimate by status; all other statuses are failures."""
WIDEST = 5
"""Columns of values that fit a terminal: the interval assuming white noise is in the JSON and in the certificate."""


def record_page(result: Mapping[str, Any], scale_is_free: bool) -> str:
    """Return one method's result: values, verdict with its reasons, a table of intervals, and the residuals.

    ``result`` holds the fields of :class:`bench.Identification` as plain values.
    """
    stated, withdrawn, residuals = result["estimates"], result["withdrawn"], result["residuals"]
    first = answer(stated, result["modes"]) + (" (95 % interval of a repeat)" if stated else "")
    head = [wrapped(first), wrapped(f"{result['method']}: {result['trust']}")]
    head += [wrapped(f"- {reason}", "    ", "  ") for reason in result["reasons"]]
    head.append(wrapped(f"record: {result['data']}, {result['samples']} samples"))
    head += [wrapped(f"note: {note}", "    ", "  ") for note in result["notes"]]
    blocks = ["\n".join(head)]
    if stated or withdrawn:
        values = values_table(stated, withdrawn)
        blocks.append(table([row[:WIDEST] for row in values.rows], values.headers[:WIDEST], (0, 2)))
    modal = (tabulate(result["modes"]) for tabulate in (modes_table, shapes_table, parameters_table))
    for grid in (*modal, runs_table(result["runs"])):
        if grid.rows:  # its first and last column hold words
            blocks.append(table(grid.rows, grid.headers, (0, len(grid.headers) - 1)))
    foot = [wrapped(f"Intervals {MEANING}.")] if stated else []
    foot += [wrapped(MODES)] if any("amplitude" in mode for mode in result["modes"]) else []
    foot += [wrapped(FREE)] if scale_is_free and (stated or withdrawn) else []
    foot += [wrapped(f"{name}: {text}") for name, text in residual_facts(residuals).items()] if residuals else []
    if residuals and residuals["part_of_signal"] < NOISE_FREE:
        foot.append(wrapped("practically free of noise: the intervals of this record reflect rounding errors only"))
    return "\n\n".join([*blocks, *(["\n".join(foot)] if foot else [])])


def methods_page(results: Sequence[Mapping[str, Any]], names: Sequence[str]) -> str:
    """Tabulate the trusted estimates of several methods, and list why each of the others has none.

    The methods without are grouped: not applicable, not installed, failed, do not trust.
    """
    trusted = [result for result in results if result["trust"] != "do not trust"]
    rows = []
    for result in trusted:
        intervals = [result["estimates"].get(name) for name in names]
        cells = [ends_text(interval) if interval else "-" for interval in intervals]
        rows.append([result["method"], result["trust"], *cells, time_text(result["wall_s"])])
    headers = ["method", "verdict", *(f"{readable(name)}, 95 %" for name in names), "time"]
    blocks = [f"record: {results[0]['data']}", *([table(rows, headers, (0, 1))] if rows else [])]
    others = group(results, lambda result: "" if result in trusted else NO_ESTIMATE.get(result["status"], "failed"))
    for heading in ("do not trust", "failed", "not applicable", "not installed"):
        reasons = group(others.get(heading, []), lambda result: result["message"] or result["reasons"][0])
        lines = [f"{', '.join(result['method'] for result in same)}: {reason}" for reason, same in reasons.items()]
        blocks += ["\n".join([f"{heading}:", *(wrapped(line, "    ", "  ") for line in lines)])] if lines else []
    return "\n\n".join(blocks)
