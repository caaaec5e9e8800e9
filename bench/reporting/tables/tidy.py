"""Columns of tidy tables, which have the same meaning in all tables, and the tidy table of all experiments.

A line holds one metric of a result. Some columns also depend on the other methods on the same data, or on the paper.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.errors import InputError
from bench.reporting.frame import ERROR, Frame, Line, Result, group, quantity
from bench.reporting.paper import judged, paper_number, row_name
from bench.reporting.ranking import first_tier
from bench.reporting.rounding import excess_text, number, percent
from bench.reporting.tables.render import Columns, listing
from bench.reporting.terminal import table, wrapped
from bench.scoring.statistics import bias_share

if TYPE_CHECKING:
    import pandas as pd

PRIMARY = ("k_over_m_error_pct", "c_over_m_error_pct", "rmse")
"""Metrics for the comparison of methods: errors of quantities that are identifiable from free vibration."""
PAPERS = (2, 3, 4, 5)
"""Tables with a counterpart in the paper."""


def _bias_pct(ratios: np.ndarray) -> float:
    return 100 * float(np.mean(ratios) - 1) if ratios.size else math.nan


def _statistic(name: str) -> Callable[[Result, str], float]:
    return lambda result, metric: result.statistic(metric, name)


VALUES: Mapping[str, Callable[[Result, str], Any]] = {
    "system": lambda result, metric: result.system,
    "initial_state": lambda result, metric: result.initial_state,
    "snr_db": lambda result, metric: result.snr_db,
    "disturbance": lambda result, metric: result.disturbance or "none",
    "size": lambda result, metric: result.disturbance_size,
    "method": lambda result, metric: result.label,
    "metric": lambda result, metric: metric,
    "quantity": lambda result, metric: quantity(metric),
    **{name: _statistic(name) for name in ("mean", "median", "ci_low", "ci_high", "bound", "excess")},
    "prior_share": lambda result, metric: result.prior_share.get(quantity(metric), math.nan),
    "bias_share": lambda result, metric: bias_share(result.successful(f"{quantity(metric)}_ratio")),
    "bias_pct": lambda result, metric: _bias_pct(result.successful(f"{quantity(metric)}_ratio")),
    "coverage_95": lambda result, metric: result.coverage(quantity(metric))[0],
    "low_95": lambda result, metric: result.coverage(quantity(metric))[1],
    "high_95": lambda result, metric: result.coverage(quantity(metric))[2],
    "n_ok": lambda result, metric: result.n_ok,
    "n": lambda result, metric: result.n,
    "state": lambda result, metric: result.state,
}
"""Values of a result and a metric, by column."""
COLUMNS = ("experiment", "table", "row", *VALUES, "tied", "paper", "verdict")


def line_of(result: Result, metric: str, columns: Iterable[str] = VALUES) -> dict[str, Any]:
    """Return a line with the values of columns in :data:`VALUES`, and the ``result`` itself."""
    return {"result": result, **{name: VALUES[name](result, metric) for name in columns if name in VALUES}}


def errors_of(result: Result) -> list[str]:
    """Return the error metrics of a result: those of quantities and of the displacement."""
    return [metric for metric in result.summary if metric.endswith(ERROR) or metric.startswith("rmse")]


def tidy_lines(
    frame: Frame, metrics: Callable[[Result], Iterable[str]] = errors_of, columns: Iterable[str] = VALUES
) -> list[Line]:
    """Return one line per cell and metric; a cell without any metric has one line."""
    tied, oracles = {}, {}
    for question, results in group(frame, lambda result: result.question).items():
        oracles[question] = next((result for result in results if result.method == "oracle" and result.stored), None)
        for metric in PRIMARY if frame.form != "open" else ():  # the open split has one data set per scenario
            tied[question, metric] = first_tier(results, [metric])
    return [
        {
            "experiment": frame.experiment, "table": frame.number, "row": row_of(frame.number, result),
            **line_of(result, metric, columns), "tied": result in tied.get((result.question, metric), ()),
            **_printed(frame.number, result, oracles[result.question], metric),
        }
        for result in frame
        for metric in metrics(result) or [""]
    ]  # fmt: skip


def row_of(table: int | None, result: Result) -> str:
    """Return the name of the corresponding row of the paper's table; empty for other tables."""
    return row_name(table, result.system, result.snr_db) if table in PAPERS else ""


def _printed(table: int | None, result: Result, oracle: Result | None, metric: str) -> Line:
    """Return the paper's number for a cell, or NaN, and the verdict on it."""
    place = paper_number(table, row_of(table, result), result.label, metric) if table in PAPERS else None
    if not result.stored or place is None:
        return {"paper": math.nan, "verdict": "" if result.stored else "not run"}
    return {"paper": place.value, "verdict": judged(place, result, oracle).text if oracle else "no oracle stored"}


def tidy_frame(frames: Iterable[Frame]) -> pd.DataFrame:
    """Return the tidy table of several experiments, with the columns :data:`COLUMNS`."""
    import pandas as pd

    lines = [line for frame in frames for line in tidy_lines(frame)]
    return pd.DataFrame(lines, columns=list(COLUMNS)).astype({"table": "Int64", "tied": "boolean"})


SHOWN: Columns[Line] = {
    "median": lambda line: number(line["median"]),
    "95 % low": lambda line: number(line["ci_low"]),
    "95 % high": lambda line: number(line["ci_high"]),
    "": lambda line: "+" if line["tied"] else "",
    "excess": lambda line: excess_text(line["excess"]),
    "coverage %": lambda line: percent(line["coverage_95"]),
    "state": lambda line: line["state"],
}
"""Columns in the terminal, after those that identify a cell."""
TEXTS = ("system", "initial state", "disturbance", "method", "state")
"""Columns in the terminal that are aligned as text."""


def frame_page(data: pd.DataFrame, metric: str) -> str:
    """Return the lines of a metric as a table for the terminal; raises InputError if no cell has the metric."""
    lines = data[data.metric == metric].rename(columns={"snr_db": "dB", "initial_state": "initial state"})
    if lines.empty:
        raise InputError("metric", metric, f"one of: {', '.join(sorted(set(data.metric) - {''})) or 'none is stored'}")
    varied = [name for name in ("system", "dB", "initial state", "disturbance", "size") if lines[name].nunique() > 1]
    first: Columns[Line] = {name: partial(_text, name) for name in [*varied, "method"]}
    rows, headers = listing(lines.to_dict("records"), {**first, **SHOWN})
    texts = [i for i, heading in enumerate(headers) if heading in TEXTS]
    legend = "+ first tier of its scenario; excess: root mean square error over the bound"
    return f"{table(rows, headers, texts)}\n\n{wrapped(legend)}"


def _text(name: str, line: Line) -> str:
    return f"{line[name]:g}" if isinstance(line[name], float) else str(line[name])
