"""The frame of everything: a line a cell and metric of every experiment that describes a table.

What a line holds is the same in all tables (:data:`bench.reporting.frame.VALUES`); here stand the columns that depend
on the other methods of a scenario, or on the paper.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import partial
from typing import TYPE_CHECKING

from bench.errors import InputError
from bench.reporting.frame import ERROR, VALUES, Frame, Line, Result, group, line
from bench.reporting.paper import paper_number, row_name
from bench.reporting.ratios import judged
from bench.reporting.rounding import excess_text, number, percent
from bench.reporting.tables.render import PRIMARY, Columns, listing, ranked
from bench.reporting.terminal import table, wrapped

if TYPE_CHECKING:
    import pandas as pd

PAPERS = (2, 3, 4, 5)
"""The tables that the paper has, too."""
COLUMNS = ("experiment", "table", "row", *VALUES, "tied", "paper", "verdict")


def tidy_frame(frames: Iterable[Frame]) -> pd.DataFrame:
    """Return the frame of everything, with the columns :data:`COLUMNS`; a cell that was not run is one line."""
    import pandas as pd

    lines = [one for frame in frames for one in tidy_lines(frame)]
    return pd.DataFrame(lines, columns=list(COLUMNS)).astype({"table": "Int64", "tied": "boolean"})


def frame_page(data: pd.DataFrame, metric: str) -> str:
    """Return the lines of a metric as a table for the terminal; raises InputError where no cell has it."""
    lines = data[data.metric == metric].to_dict("records")
    if not lines:
        raise InputError("metric", metric, f"one of: {', '.join(sorted(set(data.metric) - {''})) or 'none is stored'}")
    first: Columns[Line] = {
        heading: partial(_text, name) for name, heading in WHERE.items() if name == "method" or data[name].nunique() > 1
    }
    words = [i for i, heading in enumerate([*first, *SHOWN]) if heading in WORDS]
    legend = "+ least median error on the same data, or tied with it; excess: root mean square error over the bound"
    return f"{table(*listing(lines, {**first, **SHOWN}), words)}\n\n{wrapped(legend)}"


def _text(name: str, one: Line) -> str:
    return f"{one[name]:g}" if isinstance(one[name], float) else str(one[name])


WHERE = {"system": "system", "snr_db": "dB", "initial_state": "start", "disturbance": "disturbance", "size": "size",
         "method": "method"}  # fmt: skip
SHOWN: Columns[Line] = {
    "median": lambda one: number(one["median"]),
    "95 % low": lambda one: number(one["ci_low"]),
    "95 % high": lambda one: number(one["ci_high"]),
    "": lambda one: "+" if one["tied"] is True else "",
    "excess": lambda one: excess_text(one["excess"]),
    "cover %": lambda one: percent(one["coverage_95"]),
    "state": lambda one: one["state"],
}
"""What the terminal shows of a cell."""
WORDS = ("system", "start", "disturbance", "method", "state")


def tidy_lines(frame: Frame) -> list[Line]:
    """Return the lines of an experiment: of every cell its errors, and the verdicts on the paper's numbers."""
    lines: list[Line] = []
    replicated = frame.table.get("form") != "open"  # each of its scenarios has one data set
    for results in group(frame, lambda result: result.question).values():
        oracle = next((result for result in results if result.method == "oracle" and result.stored), None)
        rankings = {metric: ranked(results, metric) for metric in PRIMARY} if replicated else {}
        for result in results:
            row = row_of(frame.number, result)
            head = {"experiment": frame.experiment, "table": frame.number, "row": row}
            errors = [metric for metric in result.summary if metric.endswith(ERROR) or metric.startswith("rmse")]
            for metric in errors or [""]:
                ranking = rankings.get(metric)
                lines.append(
                    {
                        **head, **line(result, metric, VALUES), **printed(frame.number, result, oracle, metric),
                        "tied": ranking and not result.is_reference and result.label in ranking.level,
                    }
                )  # fmt: skip
    return lines


def row_of(table: int | None, result: Result) -> str:
    """Return the name of the row of the paper's table that a result stands in; empty for other tables."""
    return row_name(table, result.system, result.snr_db) if table in PAPERS else ""


def printed(table: int | None, result: Result, oracle: Result | None, metric: str) -> Line:
    """Return the paper's number that a cell stands beside, NaN where there is none, and the verdict on it."""
    if not result.stored:
        return {"paper": math.nan, "verdict": "not run"}
    place = paper_number(table, row_of(table, result), result.label, metric) if table in PAPERS else None
    if place is None:
        return {"paper": math.nan, "verdict": ""}
    return {"paper": place.value, "verdict": judged(place, result, oracle).text if oracle else "no oracle stored"}
