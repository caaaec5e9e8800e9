"""The table among the rows of a sheet or a text: the longest run of rows alike, and the header above it."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

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
REPEATED_TABLE = 3
"""So many rows like those of the table, but apart from it, are a piece of it; fewer above a line of words are not."""


@dataclass(slots=True)
class TableRow:
    """Cells of one row and its number in the file, from 1; ``plain`` where all are numbers."""

    line: int
    cells: list[Cell]
    plain: bool


@dataclass(frozen=True)
class Span:
    """Rows ``first`` to ``last`` (exclusive), which are alike, and whether each of their columns is text."""

    first: int
    last: int
    texts: tuple[bool | None, ...]

    @property
    def n(self) -> int:
        return self.last - self.first

    @property
    def numeric(self) -> int:
        """Number of columns with numbers."""
        return sum(text is False for text in self.texts)


def cell_of(text: str) -> Cell:
    """The number that a text is (1.0D-03 too, a point as its decimal mark), NaN where it says missing, or the text."""
    text = text.strip().replace("−", "-")
    if NUMBER.fullmatch(text):
        return float(text.replace("D", "e").replace("d", "e"))
    return NAN if text.lower() in MISSING else text


def longest_run(rows: Sequence[TableRow]) -> Span:
    """The longest run of rows of one width, with numbers in the same columns; the last of equals."""
    best = Span(0, 0, ())
    for span in _runs(rows):
        if span.numeric and span.n >= best.n:
            best = span
    return best


def _runs(rows: Sequence[TableRow]) -> Iterator[Span]:
    first, kinds = 0, list[bool | None]()
    for i, row in enumerate(rows):
        if row.plain and i > first and len(kinds) == len(row.cells) and not any(kinds):
            if None in kinds:
                kinds = [False] * len(kinds)
            continue
        merged = _merged(kinds, row.cells) if i > first else None
        if merged is None:
            if i > first:
                yield Span(first, i, tuple(kinds))
            first, kinds = i, [_kind(cell) for cell in row.cells]
        else:
            kinds = merged
    if rows:
        yield Span(first, len(rows), tuple(kinds))


def _kind(cell: Cell) -> bool | None:
    """Whether a cell is text, None where it is missing."""
    return True if isinstance(cell, str) else None if math.isnan(cell) else False


def _merged(kinds: list[bool | None], cells: list[Cell]) -> list[bool | None] | None:
    """The kinds of columns with one more row; None where it does not go with them.

    Rows of text alone are no part of a table of numbers, so a header with gaps does not start one.
    """
    if len(cells) != len(kinds):
        return None
    news = [_kind(cell) for cell in cells]
    if any(old is not None and new is not None and old != new for old, new in zip(kinds, news, strict=True)):
        return None
    if False not in kinds and False in news and (True in kinds or True in news):
        return None
    return [new if old is None else old for old, new in zip(kinds, news, strict=True)]


def check_whole(rows: Sequence[TableRow], span: Span, source: object) -> tuple[Span, list[str]]:
    """Refuse a table that a bad row cuts in two; leave out lines below it and rows of numbers above it, with a note.

    Raises:
        InputError: no table, too many rows, or a row that breaks it.
    """
    if not span.numeric:
        raise InputError("data", source, "no rows of numbers are found in it; a table of times and values is needed")
    check_rows(span.n, source)
    notes = []
    above = [i for i in range(span.first) if _alike(rows[i], span)]
    between = rows[above[-1] + 1 : span.first] if above else []
    mixed = any(_kind(cell) is False for row in between for cell in row.cells)
    if len(above) >= REPEATED_TABLE or mixed:
        broken = next(i for i in range(above[0], span.first) if not _alike(rows[i], span))
        raise _broken(rows[broken], span, source)
    numbers = [(row, found) for row in rows[: span.first] if (found := _numbers_in(row))]
    if numbers:
        row, found = numbers[-1]
        notes.append(f"numbers above the table are left out: row {row.line}, {', '.join(found)}")
    below = rows[span.last :]
    if len(below) == 1 and len(below[0].cells) < len(span.texts) and below[0].plain:
        notes.append(f"the last row of the file is cut short and left out (row {below[0].line})")
    elif any(_alike(row, span) or row.plain or len(row.cells) == len(span.texts) for row in below):
        raise _broken(below[0], span, source)
    elif below:
        notes.append(f"lines below the table are left out: {len(below)} from row {below[0].line}")
    return span, notes


def _numbers_in(row: TableRow) -> list[str]:
    """The numbers of a row that holds nothing else, whatever stands between them."""
    cells = [cell if isinstance(cell, str) else "" if math.isnan(cell) else f"{cell:g}" for cell in row.cells]
    found = [text for text in re.split(r"[\s,;]+", " ".join(cells)) if text]
    return found if all(NUMBER.fullmatch(text) for text in found) else []


def _alike(row: TableRow, span: Span) -> bool:
    if len(row.cells) != len(span.texts):
        return False
    kinds = [_kind(cell) for cell in row.cells]
    fit = all(a is None or b is None or a == b for a, b in zip(kinds, span.texts, strict=True))
    return fit and False in kinds


def _broken(row: TableRow, span: Span, source: object) -> InputError:
    shown = ", ".join(cell if isinstance(cell, str) else f"{cell:g}" for cell in row.cells)
    remedy = f"{len(span.texts)} numbers are needed as in the rest of the table, found {shown[:80]}; mend or remove it"
    return InputError("data", f"{source} row {row.line}", remedy)


def columns_of(rows: Sequence[TableRow], span: Span, names: Sequence[str], units: Sequence[str]) -> tuple[Column, ...]:
    """The columns of a run of rows; columns of text stand among them with a flaw, empty ones at the end do not."""
    body = [row.cells for row in rows[span.first : span.last]]
    if any(span.texts):
        numbers = [[NAN if isinstance(cell, str) else cell for cell in cells] for cells in body]
        values = np.array(numbers, dtype=float)
    else:
        values = np.array(body, dtype=float)
    columns = []
    for j, text in enumerate(span.texts):
        name, unit = (names[j] if j < len(names) else ""), (units[j] if j < len(units) else "")
        flaw = "" if text is False else "it is empty"
        if text:
            flaw = f"not numbers: {next(cells[j] for cells in body if isinstance(cells[j], str))}"[:40]
        columns.append(Column(name, np.ascontiguousarray(values[:, j]), unit, flaw=flaw))
    while columns and span.texts[len(columns) - 1] is None and not columns[-1].name:
        columns.pop()
    return tuple(columns)


def make_table(
    rows: Sequence[TableRow], span: Span, heading: tuple[list[str], list[str]], notes: Sequence[str]
) -> Table:
    """The table of a run of rows under its names and units."""
    lines = np.array([row.line for row in rows[span.first : span.last]])
    return Table(columns_of(rows, span, *heading), tuple(notes), lines)


@dataclass(frozen=True)
class Above:
    """A line above a table: the ways in which it may be split into cells, and whether it is a comment."""

    splits: Sequence[Sequence[str]]
    comment: bool = False


def heading_above(above: Iterable[Above], span: Span) -> tuple[list[str], list[str]]:
    """Names and units of a table's columns from the lines above it, nearest first; empty where there are none.

    The first way to split a line that fits the table's width holds. Comments and lines without a letter may stand
    between the header and the table, and a line of names above a line of units.
    """
    found: list[list[str]] = []
    for line in above:
        ways = [cells for split in line.splits for cells in (_stripped(split), _trimmed(split))]
        cells = next((cells for cells in ways if _fits(cells, span)), None)
        if cells is not None:
            found.append(cells)
        elif found or (not line.comment and _stops(line.splits[0], len(span.texts))):
            break
        if len(found) == 2:
            break
    if not found:
        return [], []
    if _is_units(found[0]) or (len(found) == 2 and _is_units_by_time(found[0], found[1])):
        names = found[1] if len(found) == 2 and not _is_units(found[1]) else []
        return names, [_bare(cell) for cell in found[0]]
    return found[0], []


def _stripped(cells: Sequence[str]) -> list[str]:
    return [cell.strip() for cell in cells]


def _trimmed(cells: Sequence[str]) -> list[str]:
    trimmed = _stripped(cells)
    while trimmed and not trimmed[-1]:
        trimmed.pop()
    return trimmed


def _fits(cells: list[str], span: Span) -> bool:
    """Whether cells are as many as the table's columns, less empty ones at its end, and none of them is a number."""
    needed = len(span.texts)
    while needed > 1 and len(cells) < needed and span.texts[needed - 1] is None:
        needed -= 1
    return len(cells) == needed and _has_letter("".join(cells)) and not any(NUMBER.fullmatch(cell) for cell in cells)


def _stops(cells: Sequence[str], width: int) -> bool:
    """Whether a line that is no header ends the search for one: words and numbers do, rulings and odd rows do not."""
    line = "".join(cells)
    return _has_letter(line) or (any(map(str.isdigit, line)) and (len(cells) != width or width == 1))


def _bare(cell: str) -> str:
    """A unit without the brackets around it."""
    match = re.fullmatch(r"\s*[(\[](.*)[)\]]\s*", cell)
    return (match[1] if match else cell).strip()


def _has_letter(text: str) -> bool:
    return re.search(r"[^\W\d_]", text) is not None


def _is_units(cells: list[str]) -> bool:
    written = [cell for cell in cells if cell]
    bracketed = all(re.fullmatch(r"\(.*\)|\[.*\]", cell) for cell in written)
    return bracketed or (len(written) > 1 and all(unit_of(cell) for cell in written))


def _is_units_by_time(cells: list[str], names: list[str]) -> bool:
    """Whether a unit of time stands below a name for time."""
    for cell, name in zip(cells, names, strict=False):
        unit = unit_of(_bare(cell))
        if unit and unit.measures == "time" and (WORDS.get(name.lower()) == "time" or name.lower() == "t"):
            return True
    return False
