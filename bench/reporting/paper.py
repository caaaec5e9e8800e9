"""The numbers that the paper prints in its Tables 2 to 5, from ``bench/data/paper_tables.csv``."""

from __future__ import annotations

import csv
import math
import re
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from bench.reporting.labels import cards

ROWS = {2: "identified", 3: "comparison"}
"""Names of the single rows of Tables 2 and 3; those of Tables 4 and 5 are named in the file."""
COLUMNS = {"rmse": "displacement_rmse", **{name: name for name in ("m_error_pct", "c_error_pct", "k_error_pct")}}
"""Of each metric its column in the file."""


@dataclass(frozen=True)
class Printed:
    """One number of the paper: where it stands, and what it is; ``method`` is as the paper's file calls it.

    A number that it only implies lies between ``low`` and ``high`` and is written as ``text``; others are both.
    """

    table: int
    row: str
    method: str
    metric: str
    low: float
    high: float
    snr_db: float
    text: str = ""

    @property
    def value(self) -> float:
        """The number, where it is printed."""
        return self.low


@cache
def _lines() -> tuple[dict[str, str], ...]:
    text = files("bench").joinpath("data", "paper_tables.csv").read_text(encoding="utf-8")
    return tuple(csv.DictReader(line for line in text.splitlines() if not line.startswith("#")))


@cache
def printed() -> tuple[Printed, ...]:
    """All numbers of the paper, in its order."""
    return tuple(
        Printed(table, ROWS.get(table, line["row"]), line["method"], metric, value, value, float(line["snr_db"]))
        for line in _lines()
        for table in [int(line["table"])]
        for metric, column in COLUMNS.items()
        if line[column]
        for value in [float(line[column])]
    )


def printed_estimate() -> tuple[dict[str, float], dict[str, float]]:
    """The estimated m, c and k that its Table 2 prints beside the errors, and the true ones."""
    line = next(line for line in _lines() if line["table"] == "2")
    found = {name: float(value) for name, value in re.findall(r"\b([mck])=([\d.]+)", line["note"])}
    return found, {name: float(line[name]) for name in found}


@cache
def _by_place() -> dict[tuple[int, str, str, str], Printed]:
    return {(p.table, p.row, p.method, p.metric): p for p in printed()}


def paper_number(table: int | None, row: str, label: str, metric: str) -> Printed | None:
    """Return the paper's number that a method of ours stands beside; None where there is none."""
    card = cards().get(label)
    return _by_place().get((table or 0, row, card.paper, metric)) if card and card.paper else None


def paper_value(table: int, row: str, label: str, metric: str) -> float:
    """Return the same as a value, NaN where there is none."""
    number = paper_number(table, row, label, metric)
    return number.value if number else math.nan


def row_name(table: int, system: str, snr_db: float) -> str:
    """The name of the row of a table in which a scenario stands."""
    return system.rpartition("_")[2] if table == 4 else ROWS.get(table, f"{snr_db:g}")


def own_method() -> str:
    """The method that the paper proposes, whose estimate its Table 2 gives."""
    return next(p.method for p in printed() if p.table == 2)
