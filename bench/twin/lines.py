"""Parsing of samples from text lines (time, one value per sensor, one per force) from standard input, file or pipe."""

from __future__ import annotations

import io
import os
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TextIO

from bench.contract.online import Sample
from bench.errors import InputError
from bench.records.reading.columns import Columns
from bench.records.reading.grid import shape_of
from bench.records.reading.table import ReadOptions, slot
from bench.records.reading.text import FORMATS, Format, format_of, read_text
from bench.records.reading.units import LETTERS

LOOK_S = 0.02
"""Interval of checks for new data in a file (s)."""
LONGEST = 65_536
"""Longest line (characters); the rest of a longer line is dropped."""
FEW, ENOUGH = 3, 20
"""Number of rows from which the columns are determined, and from which the sampling interval is estimated as well."""
MOST_ABOVE = 1000
"""Largest number of lines before the first row of numbers."""


@dataclass(frozen=True)
class Form:
    """Format of a line: separator, number of fields, and field and unit (in SI) of each role (time, values, forces)."""

    format: Format
    width: int
    fields: tuple[int, ...]
    sizes: tuple[float, ...]
    roles: tuple[str, ...]

    def __str__(self) -> str:
        return ", ".join(self.roles)

    def sample(self, text: str) -> Sample | None:
        """Parse a line; an empty field is NaN. Returns None for other lines, such as headers and comments."""
        cells = self.format.row(0, text.strip("\r\n")).cells
        if len(cells) != self.width:
            return None
        with suppress(ValueError):
            time_s, *numbers = [float(cells[i]) * size for i, size in zip(self.fields, self.sizes, strict=True)]
            values = sum(role[0] != "f" for role in self.roles) - 1
            return Sample(time_s, tuple(numbers[:values]), tuple(numbers[values:]))
        return None


def head_of(source: Iterator[str], n: int) -> tuple[list[str], list[str]]:
    """Read the lines before the first row of numbers, and further lines up to the n-th row of numbers."""
    above, lines, rows = list[str](), list[str](), 0
    for line in source:
        numbers = line.strip() and any("w" not in form.row(0, line.strip("\r\n")).kinds for form in FORMATS)
        rows += bool(numbers)
        (lines if rows else above).append(line)
        if rows == n or len(above) > MOST_ABOVE:
            break
    return above, lines


def form_of(above: Sequence[str], lines: Sequence[str], roles: Sequence[str], options: ReadOptions) -> Form:
    """Determine the format of a stream from its first lines; raises InputError if a column is ambiguous.

    The role of a column is given by ``columns=``, otherwise by the header, otherwise by the order of columns. Numbers
    without a unit are in SI units. Rows of another shape, such as an incomplete line of a serial port, are ignored.
    """
    if not lines:
        remedy = f"no line of the form {', '.join(roles)}; name other columns by a header or columns="
        raise InputError("stream", f"{len(above)} line(s)", remedy)
    cut = format_of(list(enumerate(lines)))
    rows = [cut.row(0, line.strip("\r\n")) for line in lines]
    shape = shape_of(rows)
    fitting = [line for line, row in zip(lines, rows, strict=True) if row.kinds in shape.fitting]
    try:
        table = read_text("".join([*above, *fitting]).encode(errors="replace"), "its first lines")
    except InputError as error:
        raise InputError("stream", error.value, error.remedy) from None
    columns, fields, sizes = Columns(table, options, "the stream"), [], []
    for k, role in enumerate(roles):
        fields.append(_field(role, k, columns, len(roles)))
        column = columns.in_unit(role, fields[-1], [])
        sizes.append(1.0 if column is None or column.unit is None else column.unit.size)
    columns.check_units(dict(zip(roles, fields, strict=True)))
    return Form(cut, len(shape.kinds), tuple(fields), tuple(sizes), tuple(roles))


def _field(role: str, k: int, columns: Columns, n: int) -> int:
    """Return the column number of a role, the k-th of n roles; raises InputError if it is ambiguous."""
    table, given = columns.table.columns, {slot(name): key for name, key in columns.options.columns.items()}
    if given:
        if slot(role) not in given:
            raise InputError("columns", role, f"missing; add {role}:<number>, or leave columns= out")
        return columns.number(role, given[slot(role)])
    letters, dof = LETTERS[role[0]], slot(role)[1]
    alike = [
        i for i, c in enumerate(table)
        if not c.flaw and (c.certain or c.named) == letters and (c.number or ("", dof + 1))[1] == dof + 1
    ]  # fmt: skip
    if len(alike) == 1:
        return alike[0]
    if len(table) == n:
        return k
    raise InputError("stream", role, f"its column is ambiguous among {columns.table.listing()}; give columns=")


def opened(place: str) -> TextIO:
    """Open standard input (``-``), a file or a named pipe; raises InputError."""
    if place == "-":
        if isinstance(sys.stdin, io.TextIOWrapper):
            sys.stdin.reconfigure(errors="replace")
        return sys.stdin
    try:
        return open(os.path.expanduser(place), encoding="utf-8-sig", errors="replace")
    except FileNotFoundError:
        raise InputError("from", place, "file or pipe not found; - is standard input") from None
    except OSError as error:
        raise InputError("from", place, f"cannot be read: {error.strerror}") from None


def lines_of(source: TextIO, follow: bool) -> Iterator[str]:
    """Yield the lines as they arrive; with ``follow``, wait for further lines at the end of a file.

    A line without a line break is incomplete; the rest is waited for, unless it is the last of the stream.
    """
    text = ""
    while True:
        part = source.readline(LONGEST)
        text = text[:LONGEST] + part
        if text.endswith("\n"):
            yield text
            text = ""
        elif not part and follow:
            time.sleep(LOOK_S)
        elif not part:
            if text:
                yield text
            return
