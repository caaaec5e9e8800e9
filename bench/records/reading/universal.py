"""Records in the universal file format: data sets 58, written as text or binary."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bench.errors import InputError
from bench.records.reading.packages import optional
from bench.records.reading.table import Column, Table, check_rows
from bench.records.reading.units import Measures

GENERAL, TIME_RESPONSE = 0, 1
"""Types of function that may be a record in time."""
UNKNOWN, TIME = 0, 17
"""Types of an abscissa."""
MEASURED: dict[int, Measures] = {
    8: "displacement", 9: "force", 11: "velocity", 12: "acceleration", 13: "force",
}  # fmt: skip
"""Types of an ordinate: 9 is a reaction force, 13 an excitation."""


def read_universal(path: Path) -> Table:
    """The data sets 58 of a file as columns, each with its own times.

    Raises:
        InputError: none is a record in time, one is cut short, or pyuff is missing.
    """
    pyuff = optional("pyuff", path)
    file = pyuff.UFF(str(path))
    types = [int(kind) for kind in file.get_set_types()]
    numbers = [i for i, kind in enumerate(types) if kind == 58]
    if not numbers:
        held = ", ".join(map(str, sorted(set(types)))) or "none"
        raise InputError("data", path, f"a data set 58 is needed; it holds {held}")
    columns = [_column(file, i, path) for i in numbers]
    if all(column.flaw for column in columns):
        raise InputError("data", path, f"no data set is a record in time: {columns[0].flaw}; export the time response")
    return Table(tuple(columns))


def _column(file: Any, i: int, path: Path) -> Column:
    head = file.read_sets(i, header_only=True)
    check_rows(int(head["num_pts"]), path)
    label, unit = _written(head["ordinate_axis_lab"]), _written(head["ordinate_axis_units_lab"])
    node = f"node {head['rsp_node']}" if head["rsp_node"] else _written(head["rsp_ent_name"])
    name = " ".join(part for part in (label, node) if part) or _written(head["id1"])
    measures = MEASURED.get(int(head["ordinate_spec_data_type"]))
    flaw = _flaw(head)
    if flaw:
        return Column(name, np.full(1, np.nan), unit, measures, flaw=flaw)
    body = file.read_sets(i)
    values, times = np.asarray(body["data"], float), np.asarray(body["x"], float)
    if values.size != int(head["num_pts"]):
        remedy = f"{head['num_pts']} values are announced; write the file again"
        raise InputError("data", f"{path} data set {i} of {values.size} values", remedy)
    return Column(name, values, unit, measures, times)


def _flaw(head: dict[str, Any]) -> str:
    if head["func_type"] not in (GENERAL, TIME_RESPONSE):
        return f"a spectrum or another function (type {head['func_type']})"
    if head["abscissa_spec_data_type"] not in (UNKNOWN, TIME):
        return f"not over time (abscissa type {head['abscissa_spec_data_type']})"
    if _written(head["abscissa_axis_units_lab"]) not in ("", "s", "sec", "S", "SEC"):
        return f"its times are in {head['abscissa_axis_units_lab']}, not in s"
    return "complex values" if head["ord_data_type"] in (5, 6) else ""


def _written(text: object) -> str:
    """A label, "" where the file says there is none."""
    written = " ".join(str(text).split())
    return "" if written.upper() == "NONE" else written
