"""The frame of everything: a line a cell and metric of every experiment that describes a table.

What a line holds is the same in all tables (:data:`bench.reporting.frame.VALUES`); here stand the columns that depend
on the other methods of a scenario, or on the paper.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

from bench.reporting.frame import ERROR, VALUES, Frame, Line, Result, group, line
from bench.reporting.paper import paper_number, row_name
from bench.reporting.ratios import judged
from bench.reporting.tables.render import PRIMARY, ranked

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
