"""The table among the rows of a sheet or a text: rows of one width with numbers in the same columns, and its header."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from bench.errors import InputError
from bench.records.reading.headings import WORDS
from bench.records.reading.table import Column, Table, check_rows
from bench.records.reading.units import unit_of

Cell = float | str
"""A number, NaN where it is missing, or else the text."""
MISSING = {
    "", "-", "--", "---", "nan", "na", "n/a", "null", "none", "#n/a", "#div/0!", "#value!", "#num!", "#ref!", "1.#qnan",
    "-1.#ind", "inf", "+inf", "-inf",
}  # fmt: skip
NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?")
NAN = float("nan")
OF_PREAMBLE = 2
"""So many rows like those of the table, above a line of words, are of a preamble; more are a piece of a table."""


@dataclass(slots=True)
class TableRow:
    """Cells of one row and its number in the file, from 1; ``plain`` where all are numbers."""

    line: int
    cells: list[Cell]
    plain: bool

    @property
    def numeric(self) -> bool:
        """Whether it holds a number."""
        return self.plain or any(_kind(cell) is False for cell in self.cells)


@dataclass(frozen=True)
class RowShape:
    """Whether each column of a table is text (None where it is empty), and how many rows have these columns."""

    texts: tuple[bool | None, ...] = ()
    n: int = 0

    @property
    def numeric(self) -> int:
        """Number of columns with numbers."""
        return sum(text is False for text in self.texts)

    def fits(self, row: TableRow) -> bool:
        """Return whether a row has these columns, with a number in one of them at least."""
        if len(row.cells) != len(self.texts):
            return False
        if row.plain:
            return True not in self.texts
        kinds = [_kind(cell) for cell in row.cells]
        return False in kinds and all(a is None or b in (a, None) for a, b in zip(kinds, self.texts, strict=True))


def cell_of(text: str) -> Cell:
    """Return the number that a text is (1.0D-03 too), NaN where it says missing, or the text."""
    text = text.strip().replace("−", "-")
    if NUMBER.fullmatch(text):
        return float(text.replace("D", "e").replace("d", "e"))
    return NAN if text.lower() in MISSING else text


def _kind(cell: Cell) -> bool | None:
    """Return whether a cell is text, None where it is missing."""
    return True if isinstance(cell, str) else None if math.isnan(cell) else False


def row_of(line: int, cells: list[Cell]) -> TableRow:
    """Return a row of cells that may be anything."""
    return TableRow(line, cells, not any(isinstance(cell, str) or math.isnan(cell) for cell in cells))


def shape_of(rows: Sequence[TableRow]) -> RowShape:
    """Return the shape of most rows with numbers; a column is text where most of its cells are."""
    numeric = [row for row in rows if row.numeric]
    widths = Counter(len(row.cells) for row in numeric)
    if not widths:
        return RowShape()
    width = max(widths, key=lambda width: (widths[width], width))
    numeric = [row for row in numeric if len(row.cells) == width]
    plain = sum(row.plain for row in numeric)
    kinds = [[_kind(cell) for cell in row.cells] for row in numeric if not row.plain]
    counts = [Counter(column) for column in zip(*kinds, strict=True)]
    texts = [n[True] > n[False] + plain if n[True] + n[False] + plain else None for n in counts]
    shape = RowShape(tuple(texts) if texts else (False,) * width)
    return RowShape(shape.texts, sum(map(shape.fits, rows)))


def bounds(rows: Sequence[TableRow], shape: RowShape, source: object) -> tuple[int, int, list[str]]:
    """Return the first row of a table and that behind its last, and notes of rows outside that are left out.

    Raises:
        InputError: no table, too many rows, or a row that breaks it.
    """
    fitting = [i for i, row in enumerate(rows) if shape.fits(row)]
    if not shape.numeric or not fitting:
        raise InputError("data", source, "no rows of numbers are found in it; a table of times and values is needed")
    check_rows(len(fitting), source)
    first, last, notes = fitting[0], fitting[-1] + 1, []
    for i, j in pairwise(fitting[: OF_PREAMBLE + 1]):
        if j > i + 1 and not any(row.numeric for row in rows[i + 1 : j]):
            first = j
    inside = fitting[fitting.index(first) :]
    if len(inside) < last - first:
        i = next(i for i, j in zip(range(first, last), inside, strict=False) if i != j)
        raise _broken(rows[i], shape, source)
    for row in reversed(rows[:first]):
        if row.numeric and (numbers := _numbers_in(row)):
            notes.append(f"numbers above the table are left out: row {row.line}, {', '.join(numbers)}")
            break
    below = rows[last:]
    if len(below) == 1 and len(below[0].cells) < len(shape.texts) and below[0].plain:
        notes.append(f"the last row of the file is cut short and left out (row {below[0].line})")
    elif any(row.plain or len(row.cells) == len(shape.texts) for row in below):
        raise _broken(below[0], shape, source)
    elif below:
        notes.append(f"lines below the table are left out: {len(below)} from row {below[0].line}")
    return first, last, notes


def _numbers_in(row: TableRow) -> list[str]:
    """Return the numbers of a row that holds nothing else, whatever stands between them."""
    texts = re.split(r"[\s,;]+", " ".join(map(shown, row.cells)).strip())
    return texts if all(map(NUMBER.fullmatch, texts)) else []


def shown(cell: Cell) -> str:
    """Return a cell as text, "" where it is missing."""
    return cell if isinstance(cell, str) else "" if math.isnan(cell) else f"{cell:g}"


def _broken(row: TableRow, shape: RowShape, source: object) -> InputError:
    cells = ", ".join(cell if isinstance(cell, str) else f"{cell:g}" for cell in row.cells)[:80]
    remedy = f"{len(shape.texts)} numbers are needed as in the rest of the table, found {cells}; mend or remove it"
    return InputError("data", f"{source} row {row.line}", remedy)


def make_table(
    rows: Sequence[TableRow], shape: RowShape, heading: tuple[list[str], list[str]], notes: Iterable[str]
) -> Table:
    """Return the table of rows under names and units; columns of text have a flaw, empty ones at the end go."""
    names, units = ([*given, *[""] * len(shape.texts)] for given in heading)
    columns = []
    for j, text in enumerate(shape.texts):
        cells = [row.cells[j] for row in rows]
        flaw = "" if text is False else "it is empty"
        if text:
            flaw = f"not numbers: {next((cell for cell in cells if isinstance(cell, str)), 'words')}"[:40]
        values = np.full(len(rows), NAN) if flaw else np.array(cells, dtype=float)
        columns.append(Column(names[j], values, units[j], flaw=flaw))
    while columns and shape.texts[len(columns) - 1] is None and not columns[-1].name:
        columns.pop()
    return Table(tuple(columns), tuple(notes), np.array([row.line for row in rows]))


@dataclass(frozen=True)
class Above:
    """A line above a table: the ways in which it may be split into cells, and whether it is a comment."""

    splits: Sequence[Sequence[str]]
    comment: bool = False


def heading_above(above: Iterable[Above], shape: RowShape) -> tuple[list[str], list[str]]:
    """Return names and units of columns from the lines above them, nearest first; empty where there are none.

    The first way to split a line that fits the table's width holds. Comments and lines without a letter may stand
    between the header and the table, and a line of names above a line of units.
    """
    width = len(shape.texts)
    least = width - next((k for k, text in enumerate(reversed(shape.texts)) if text is not None), 0)
    lines: list[list[str]] = []
    for line in above:
        header = next((cells for split in line.splits if (cells := _header(split, least, width))), None)
        if header is not None:
            lines.append(header)
        elif lines or (not line.comment and _stops(line.splits[0], width)):
            break
        if len(lines) == 2:
            break
    if lines and (_are_units(lines[0]) or (len(lines) == 2 and _are_units_by_time(lines[0], lines[1]))):
        names = lines[1] if len(lines) == 2 and not _are_units(lines[1]) else []
        return names, [_bare(cell) for cell in lines[0]]
    return (lines[0] if lines else []), []


def _header(split: Sequence[str], least: int, width: int) -> list[str]:
    """Return a line's cells where they are as many as the table's columns and hold words, but no number; else none."""
    cells = [cell.strip() for cell in split]
    while len(cells) > width and not cells[-1]:
        cells.pop()
    words = _has_letter("".join(cells)) and not any(map(NUMBER.fullmatch, cells))
    return cells if least <= len(cells) <= width and words else []


def _stops(cells: Sequence[str], width: int) -> bool:
    """Return whether a line that is no header ends the search: words and numbers do, rulings and odd rows do not."""
    line = "".join(cells)
    return _has_letter(line) or (any(map(str.isdigit, line)) and (len(cells) != width or width == 1))


def _bare(cell: str) -> str:
    """Return a unit without the brackets around it."""
    match = re.fullmatch(r"\s*[(\[](.*)[)\]]\s*", cell)
    return (match[1] if match else cell).strip()


def _has_letter(text: str) -> bool:
    return re.search(r"[^\W\d_]", text) is not None


def _are_units(cells: list[str]) -> bool:
    written = [cell for cell in cells if cell]
    bracketed = all(re.fullmatch(r"\(.*\)|\[.*\]", cell) for cell in written)
    return bracketed or (len(written) > 1 and all(unit_of(cell) for cell in written))


def _are_units_by_time(cells: list[str], names: list[str]) -> bool:
    """Return whether a unit of time stands below a name for time."""
    units = [unit_of(_bare(cell)) for cell, name in zip(cells, names, strict=False) if _is_time(name.lower())]
    return any(unit is not None and unit.measures == "time" for unit in units)


def _is_time(name: str) -> bool:
    return name == "t" or WORDS.get(name) == "time"
