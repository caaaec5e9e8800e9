"""Detection of the table in a text or sheet: rows of equal width with numbers in the same columns, and a header."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import islice, pairwise
from typing import NamedTuple

import numpy as np

from bench.errors import InputError
from bench.records.reading.headings import WORDS, column_of
from bench.records.reading.table import Table, check_size
from bench.records.reading.units import unit_of

Cell = float | str
"""A number, NaN if it is missing, or a text."""
MISSING = {
    "", "-", "--", "---", "nan", "na", "n/a", "null", "none", "#n/a", "#div/0!", "#value!", "#num!", "#ref!", "1.#qnan",
    "-1.#ind", "inf", "+inf", "-inf",
}  # fmt: skip
NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?")
LETTER = re.compile(r"[^\W\d_]")
BRACKETED = re.compile(r"\(.*\)|\[.*\]")
HEADER_LINES = 30
"""Number of lines above a table in which a header is sought."""
OF_PREAMBLE = 2
"""Largest number of rows like those of the table that belong to a preamble, if a line of words follows them."""


class TableRow(NamedTuple):
    """Number of a row in the file (from 1), its cells, and their kinds: "n" number, "w" words, "-" missing."""

    line: int
    cells: list[Cell]
    kinds: str

    @property
    def texts(self) -> list[str]:
        """Cells as text."""
        return [cell if isinstance(cell, str) else f"{cell:g}" for cell in self.cells]


class RowShape(NamedTuple):
    """Kinds of the columns of a table (as those of a row), the kinds of rows that fit, and the number of such rows."""

    kinds: str = ""
    fitting: frozenset[str] = frozenset()
    n: int = 0


class LineAbove(NamedTuple):
    """Line above a table: possible divisions into cells, and whether it is a comment."""

    ways: Sequence[Sequence[str]]
    comment: bool = False


def row_of(line: int, texts: Iterable[str], decimal: str = ".") -> TableRow:
    """Return a row of texts, with numbers converted."""
    cells = [_cell(text, decimal) for text in texts]
    return TableRow(line, cells, "".join("w" if isinstance(c, str) else "-" if math.isnan(c) else "n" for c in cells))


def _cell(text: str, decimal: str) -> Cell:
    """Convert a text to a number (also 1.0D-03), to NaN if it denotes a missing value, or return the text."""
    text = text.strip().replace("−", "-")
    number = text if decimal == "." else text.replace(".", ";").replace(",", ".")
    if NUMBER.fullmatch(number):
        return float(number.replace("D", "e").replace("d", "e"))
    return math.nan if text.lower() in MISSING else text


def shape_of(rows: Sequence[TableRow]) -> RowShape:
    """Return the shape of the majority of the rows with numbers; a column is words if most of its cells are."""
    counts = Counter(row.kinds for row in rows)
    widths: Counter[int] = Counter()
    for kinds, n in counts.items():
        widths[len(kinds)] += n * ("n" in kinds)
    width = max(widths, key=lambda width: (widths[width], width), default=0)
    if not widths[width]:
        return RowShape()
    columns = ""
    numeric = {kinds: n for kinds, n in counts.items() if len(kinds) == width and "n" in kinds}
    for j in range(width):
        numbers, words = (sum(n for kinds, n in numeric.items() if kinds[j] == letter) for letter in "nw")
        columns += "w" if words > numbers else "n" if numbers else "-"
    fitting = {kinds for kinds in numeric if all(a in ("-", b) for a, b in zip(kinds, columns, strict=True))}
    return RowShape(columns, frozenset(fitting), sum(counts[kinds] for kinds in fitting))


def make_table(
    rows: Sequence[TableRow], shape: RowShape, bounds: tuple[int, int], above: Iterable[LineAbove], source: object
) -> Table:
    """Return the table in a range of rows.

    Columns of words have a flaw, and empty columns at the end are dropped.

    Args:
        rows: All rows of the file.
        shape: Shape of the table.
        bounds: First row of the table, and the row after its last.
        above: Lines above the table, nearest first, which may contain names and units.
        source: Name of the file, for errors.

    Raises:
        InputError: Rows below the table also look like rows of the table.
    """
    first, last = bounds
    notes = _notes_of_rest(rows, first, last, shape, source)
    names, units = ([*given, *[""] * len(shape.kinds)] for given in _heading(above, shape))
    columns = []
    for j, kind in enumerate(shape.kinds):
        cells = [row.cells[j] for row in rows[first:last]]
        words = next((cell for cell in cells if isinstance(cell, str)), "words")
        flaw = {"n": "", "w": f"not numbers: {words}"[:40], "-": "it is empty"}[kind]
        values = np.full(len(cells), np.nan) if flaw else np.array(cells, dtype=float)
        columns.append(column_of(names[j], values, units[j], flaw=flaw))
    while columns[-1].flaw == "it is empty" and not columns[-1].header:
        columns.pop()
    return Table(tuple(columns), notes, np.array([row.line for row in rows[first:last]]))


def bounds_of(rows: Sequence[TableRow], shape: RowShape, source: object) -> tuple[int, int]:
    """Return the first row of a table and the row after its last; raises InputError for no or an invalid table."""
    fitting = [i for i, row in enumerate(rows) if row.kinds in shape.fitting]
    if not fitting:
        raise InputError("data", source, "it has no rows of numbers; a table of times and values is needed")
    check_size(len(fitting), source)
    first, last = fitting[0], fitting[-1] + 1
    for i, j in pairwise(fitting[: OF_PREAMBLE + 1]):
        if j > i + 1 and not any("n" in row.kinds for row in rows[i + 1 : j]):
            first = j
    for row in rows[first:last]:
        if row.kinds not in shape.fitting:
            raise _invalid(row, shape, source)
    return first, last


def _notes_of_rest(rows: Sequence[TableRow], first: int, last: int, shape: RowShape, source: object) -> tuple[str, ...]:
    """Return notes on the ignored rows above and below a table; raises InputError for table rows below."""
    notes, below = [], rows[last:]
    for row in reversed(rows[:first]):
        numbers = re.split(r"[\s,;]+", " ".join(row.texts).replace("nan", "").strip())
        if "n" in row.kinds and all(map(NUMBER.fullmatch, numbers)):
            notes.append(f"numbers above the table are ignored: row {row.line}, {', '.join(numbers)}")
            break
    if len(below) == 1 and below[0].kinds == "n" * len(below[0].cells) and len(below[0].cells) < len(shape.kinds):
        notes.append(f"the last row of the file (row {below[0].line}) is incomplete and ignored")
    elif any(set(row.kinds) == {"n"} or len(row.cells) == len(shape.kinds) for row in below):
        raise _invalid(below[0], shape, source)
    elif below:
        notes.append(f"lines below the table are ignored: {len(below)} from row {below[0].line}")
    return tuple(notes)


def _invalid(row: TableRow, shape: RowShape, source: object) -> InputError:
    remedy = f"{len(shape.kinds)} numbers are needed, not {', '.join(row.texts)[:80]}; correct or delete this row"
    return InputError("data", f"{source} row {row.line}", remedy)


def _heading(above: Iterable[LineAbove], shape: RowShape) -> tuple[list[str], list[str]]:
    """Return names and units of the columns from the lines above them (nearest first); empty without a header.

    The first division of a line that fits the width of the table is used. Comments, rules and rows of numbers may
    separate the header from the table. The header may be a line of names above a line of units.
    """
    lines: list[list[str]] = []
    for line in islice(above, HEADER_LINES):
        text, odd = "".join(line.ways[0]), len(line.ways[0]) != len(shape.kinds) or len(shape.kinds) == 1
        if header := next((cells for way in line.ways if (cells := _header(way, shape))), None):
            lines.append(header)
        elif lines or (not line.comment and (LETTER.search(text) or (odd and any(map(str.isdigit, text))))):
            break
        if len(lines) == 2:
            break
    names, units = (lines[1] if len(lines) == 2 else []), (lines[0] if lines else [])
    if _are_units(units, names):
        bare = [cell[1:-1].strip() if BRACKETED.fullmatch(cell) else cell for cell in units]
        return ([] if _are_units(names, []) else names), bare
    return units, []


def _header(way: Sequence[str], shape: RowShape) -> list[str]:
    """Return the cells of a line if their number is that of the columns and they have words but no numbers."""
    width, least = len(shape.kinds), len(shape.kinds.rstrip("-"))
    cells = [cell.strip() for cell in way]
    while len(cells) > width and not cells[-1]:
        cells.pop()
    words = LETTER.search("".join(cells)) and not any(map(NUMBER.fullmatch, cells))
    return cells if least <= len(cells) <= width and words else []


def _are_units(cells: Sequence[str], names: Sequence[str]) -> bool:
    """Return whether cells are units: all in brackets, all known, or one of time below a name of time."""
    written = [cell for cell in cells if cell]
    if written and (all(map(BRACKETED.fullmatch, written)) or (len(written) > 1 and all(map(unit_of, written)))):
        return True
    units = [
        unit_of(cell)
        for cell, name in zip(cells, names, strict=False)
        if WORDS.get(name.lower(), name) in ("t", "time")
    ]
    return any(unit is not None and unit.measures == "time" for unit in units)
