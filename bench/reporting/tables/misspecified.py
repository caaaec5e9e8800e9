"""What becomes of estimates and their intervals where the model is wrong: the table of ``experiment=misspecified``.

It stands for every experiment whose ``table`` has the form ``misspecified``: one panel for each thing that is wrong,
which is a disturbance that the model has not, or a prior whose nominal values are off.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from bench.reporting.frame import ERROR, Frame, Result, group
from bench.reporting.labels import title as title_of
from bench.reporting.labels import warns
from bench.reporting.residuals import coloured
from bench.reporting.rounding import excess_text, number, readable
from bench.reporting.tables.common import Line, csv, failure_notes, markdown_table
from bench.scoring.statistics import wilson_interval

COLUMNS = (
    "wrong", "system", "initial_state", "snr_db", "method", "quantity", "median_error_pct", "bias_pct", "excess",
    "coverage_95", "low_95", "high_95", "said", "coloured", "n_ok", "n",
)  # fmt: skip
RIGHT = "nothing"
"""What is wrong where model and prior are right."""
QUANTITIES = ("k_over_m", "c_over_m", "m")
LEGEND = """What is fitted is one mass with a viscous damper and a linear spring; the data are of something else, or the
nominal values are off by three standard deviations. Errors are against what truth and model have in common: the
stiffness at small amplitude, the viscous part of the damping, the first mode. Each entry: the median error in percent,
and after × the root mean square error over the Cramér-Rao bound of the right model, with white noise alone. Bias: the
mean of estimate over truth, less one, in percent. 95 %: the share of the 95 % intervals that held the truth, with its
own 95 % interval (Wilson's); below what they claim, a method is wrong and does not say so. Said: the share of the fits
that gave no answer or one with a warning. Residuals: the share of the answers whose residuals a user can tell from
white noise (Ljung-Box test at 5 % of the best response of k/m and c/m; the panel in which nothing is wrong shows its
false alarms). ok: fits that gave an answer, of all; the others count as infinite errors in medians. *oracle* starts at
the truth, and has the same wrong model. A dash: the method does not tell it."""


def wrong(result: Result) -> str:
    """What is wrong: the kind of disturbance, a wrong prior, or nothing."""
    if result.disturbance:
        return result.disturbance
    return "wrong_prior" if (result.prior or {}).get("wrong") else RIGHT


def lines(results: Sequence[Result]) -> list[Line]:
    """One line a cell and quantity; a cell that was not run has n = 0."""
    noticed = coloured(results)
    return [_line(result, quantity, noticed) for result in results for quantity in QUANTITIES]


def _line(result: Result, quantity: str, noticed: Mapping[str, np.ndarray]) -> Line:
    by_residuals = noticed.get(result.identity, np.empty(0))
    ratios = result.successful(f"{quantity}_ratio")
    hits = result.successful(f"{quantity}_coverage_95")
    low, high = wilson_interval(int(hits.sum()), hits.size) if hits.size else (math.nan, math.nan)
    return {
        "wrong": wrong(result), "system": result.system, "initial_state": result.initial_state,
        "snr_db": result.snr_db, "method": result.label, "quantity": quantity,
        "median_error_pct": result.statistic(quantity + ERROR, "median"),
        "bias_pct": 100 * float(np.mean(ratios) - 1) if ratios.size else math.nan,
        "excess": result.excess(quantity + ERROR),
        "coverage_95": float(hits.mean()) if hits.size else math.nan, "low_95": low, "high_95": high,
        "said": _said(result), "coloured": float(by_residuals.mean()) if by_residuals.size else math.nan,
        "n_ok": result.n_ok, "n": result.n,
    }  # fmt: skip


def _said(result: Result) -> float:
    """The share of the fits that failed or came with a warning; NaN where messages are no warnings."""
    if not result.n or not warns(result.label):
        return math.nan
    return float(np.mean([not ok or bool(message) for ok, message in zip(result.ok, result.messages, strict=True)]))


def _panel(data: Sequence[Line]) -> str:
    rows = []
    for own in group(data, lambda line: (line["system"], line["snr_db"], line["method"])).values():
        cells = [cell for line in own for cell in (_error(line), number(line["bias_pct"]), _coverage(line))]
        shares = ["-" if math.isnan(own[0][key]) else f"{100 * own[0][key]:.0f}" for key in ("said", "coloured")]
        ok = f"{own[0]['n_ok']}/{own[0]['n']}" if own[0]["n"] else "not run"
        rows.append([title_of(own[0]["method"]), f"{own[0]['snr_db']:g}", *cells, *shares, ok])
    what = [f"{readable(name)} {part}" for name in QUANTITIES for part in ("error %", "bias %", "95 %")]
    return markdown_table(rows, ["method", "SNR (dB)", *what, "said %", "residuals %", "ok"])


def _error(line: Line) -> str:
    excess = line["excess"]
    return number(line["median_error_pct"]) + (f" ×{excess_text(excess)}" if math.isfinite(excess) else "")


def _coverage(line: Line) -> str:
    if math.isnan(line["coverage_95"]):
        return "-"
    share, low, high = (f"{100 * line[key]:.0f}" for key in ("coverage_95", "low_95", "high_95"))
    return f"{share} ({low} to {high})"


def misspecified_table(frame: Frame) -> Mapping[str, str]:
    """The files of the table by name; none where the store holds no cell of it in which something is wrong."""
    if not any(result.stored for result in frame if wrong(result) != RIGHT):
        return {}
    data = lines(frame.results)
    parts = [f"# {frame.title}", LEGEND]
    for (what, told), own in group(data, lambda line: (line["wrong"], line["initial_state"])).items():
        parts += [f"## Wrong: {what.replace('_', ' ')}; initial state {told}", _panel(own)]
    notes = failure_notes(frame)
    parts += [f"## What failed\n\n{notes}"] if notes else []
    parts.append(f"Regenerate: `{frame.command}`")
    name = frame.experiment
    return {f"{name}.md": "\n\n".join(parts) + "\n", f"{name}.csv": csv(data, columns=COLUMNS)}
