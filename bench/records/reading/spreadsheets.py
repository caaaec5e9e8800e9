"""Records in the sheets of a workbook (xlsx): the first sheet with a table of numbers."""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Iterable, Sequence

from bench.errors import InputError
from bench.records.reading.grid import (
    NAN,
    Above,
    Cell,
    TableRow,
    cell_of,
    check_whole,
    heading_above,
    longest_run,
    make_table,
)
from bench.records.reading.packages import optional
from bench.records.reading.table import MAX_ROWS, Table, check_rows


def read_workbook(data: bytes, source: object) -> Table:
    """The table of the first sheet that has one, with a note of which where there are more sheets.

    Raises:
        InputError: no sheet has rows of numbers, or openpyxl is missing.
    """
    openpyxl = optional("openpyxl", source)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of styles and checks that openpyxl does not know
        book = openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=True)
        sheets = [(sheet.title, _rows(sheet.iter_rows(values_only=True), source)) for sheet in book.worksheets]
    for title, rows in sheets:
        span = longest_run(rows)
        if not span.numeric or span.n < 2:
            continue
        span, notes = check_whole(rows, span, f"{source} sheet '{title}'")
        above = [Above([[_text(cell) for cell in row.cells]]) for row in reversed(rows[: span.first])]
        if len(sheets) > 1:
            notes.insert(0, f"the workbook has {len(sheets)} sheets; '{title}' is read")
        return make_table(rows, span, heading_above(above, span), notes)
    raise InputError("data", source, "no sheet has rows of numbers; a table of times and values is needed")


def _rows(cells: Iterable[Sequence[object]], source: object) -> list[TableRow]:
    rows = []
    for i, values in enumerate(cells, 1):
        if i > MAX_ROWS + 1000:
            check_rows(i, source)
        found = [_cell(value) for value in values]
        if any(isinstance(cell, str) or not math.isnan(cell) for cell in found):
            rows.append(TableRow(i, found, not any(isinstance(cell, str) or math.isnan(cell) for cell in found)))
    width = max((len(row.cells) for row in rows), default=0)
    for row in rows:
        if len(row.cells) < width:
            row.cells.extend([NAN] * (width - len(row.cells)))
            row.plain = False
    return rows


def _cell(value: object) -> Cell:
    if value is None:
        return NAN
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    return cell_of(str(value))


def _text(cell: Cell) -> str:
    return cell if isinstance(cell, str) else "" if math.isnan(cell) else f"{cell:g}"
