"""What becomes of estimates and their intervals where the model is wrong: the table of ``experiment=misspecified``.

It stands for every experiment whose ``table`` has the form ``misspecified``: one panel for each thing that is wrong,
which is a disturbance that the model has not, or a prior whose nominal values are off.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from bench.reporting.frame import ERROR, Frame, Line, Result, group, line
from bench.reporting.labels import warns
from bench.reporting.residuals import coloured
from bench.reporting.rounding import answered, number, percent, percent_between, readable, with_excess
from bench.reporting.tables.render import NAMED, NOISE, Columns, Rows, ending, files, panel

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
    return [
        {
            **line(result, name + ERROR, COLUMNS), "wrong": wrong(result),
            "median_error_pct": result.statistic(name + ERROR, "median"), "said": said(result),
            "coloured": np.mean(noticed[result.identity]) if np.size(noticed.get(result.identity, ())) else np.nan,
        }
        for result in results
        for name in QUANTITIES
    ]  # fmt: skip


def said(result: Result) -> float:
    """The share of the fits that failed or came with a warning; NaN where messages are no warnings."""
    if not result.n or not warns(result.label):
        return np.nan
    return float(np.mean([not ok or bool(message) for ok, message in zip(result.ok, result.messages, strict=True)]))


def _panel(data: Sequence[Line]) -> Rows:
    return panel(
        data,
        lambda one: (one["system"], one["snr_db"], one["method"]),
        {**NAMED, **NOISE},
        lambda one: one["quantity"],
        _quantity,
        {
            "said %": lambda own: percent(own[0]["said"]),
            "residuals %": lambda own: percent(own[0]["coloured"]),
            "ok": lambda own: answered(own[0]["n_ok"], own[0]["n"]),
        },
    )


def _quantity(any_line: Line) -> Columns[Line]:
    name = readable(any_line["quantity"])
    return {
        f"{name} error %": lambda one: with_excess(one["median_error_pct"], one["excess"]),
        f"{name} bias %": lambda one: number(one["bias_pct"]),
        f"{name} 95 %": lambda one: percent_between(one["coverage_95"], one["low_95"], one["high_95"]),
    }


def misspecified_table(frame: Frame) -> Mapping[str, str]:
    """The files of the table by name; none where the store holds no cell of it in which something is wrong."""
    if not any(result.stored for result in frame if wrong(result) != RIGHT):
        return {}
    data = lines(frame.results)
    parts: list[str | Rows] = [f"# {frame.title}", LEGEND]
    for (what, told), own in group(data, lambda one: (one["wrong"], one["initial_state"])).items():
        parts += [f"## Wrong: {what.replace('_', ' ')}; initial state {told}", _panel(own)]
    return files(frame.name, [*parts, *ending(frame)], data, COLUMNS)
