"""Records written as text: the encoding, the separator and the decimal mark are found in the file itself."""

from __future__ import annotations

import csv
import re
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice, pairwise

import numpy as np

from bench.errors import InputError
from bench.records.reading.grid import (
    Above,
    Cell,
    RowShape,
    TableRow,
    bounds,
    cell_of,
    heading_above,
    make_table,
    row_of,
    shape_of,
)
from bench.records.reading.table import Table, check_rows, check_values

COMMENTS = ("#", "%", "!", "//")
MARKS = (("utf-8-sig", b"\xef\xbb\xbf"), ("utf-16", b"\xff\xfe"), ("utf-16", b"\xfe\xff"))
LOOKED_AT = 4096
HEAD_LETTERS = 100_000
"""So much of a text shows whether its rows end in a mark."""
SAMPLED, BLOCK = 3000, 600
"""A file of more lines than this is judged by three blocks of lines."""
HEADER_LINES = 30
"""So far above a table a header is looked for, comments between them."""
PREAMBLE = 10_000
LONGEST_LINE = 32_768
"""Of a text, in bytes."""
THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(?:,\d{3})+")


@dataclass(frozen=True)
class Format:
    """What stands between cells (None for blanks) and before the decimals."""

    separator: str | None
    decimal: str

    def fields(self, line: str) -> list[str]:
        """Return the cells of a line as text; quotes keep separators inside a cell."""
        if self.separator is None:
            return line.replace('"', " ").split()
        if '"' not in line:
            return line.split(self.separator)
        return next(csv.reader([line], delimiter=self.separator, skipinitialspace=True))

    def row(self, number: int, line: str) -> TableRow:
        """Return the row of a line; what is no number in this format is text."""
        if self.decimal == "," and self.separator != "," and "." not in line:
            simple = line.replace(",", ".")
        else:
            simple = line if self.decimal == "." else ""
        if simple and not any(letter in line for letter in '"_n'):  # fast, and of numbers alone
            with suppress(ValueError):
                return TableRow(number, [float(text) for text in simple.split(self.separator)], True)
        return self.row_of(number, self.fields(line))

    def row_of(self, number: int, fields: Sequence[str]) -> TableRow:
        """Return the row of cells that may be anything."""
        return row_of(number, [self._cell(text) for text in fields])

    def _cell(self, text: str) -> Cell:
        if self.decimal == ".":
            return cell_of(text)
        cell = cell_of(text.replace(",", "."))  # a point is no decimal mark here
        return text if isinstance(cell, str) or ("." in text and cell == cell) else cell


BLANKS = Format(None, ".")
FORMATS = [
    *(Format(separator, decimal) for separator in (";", "\t", ",") for decimal in (".", ",")),
    BLANKS,
    Format(None, ","),
]


def read_text(data: bytes, source: object) -> Table:
    """Return the table in the bytes of a text.

    Raises:
        InputError: it is no text, holds no table, or more than one reading is possible.
    """
    _check_shape(data.rstrip(b"\0"), source)  # loggers fill up a block with zeros
    text = decode(data, source).replace("\r\n", "\n").replace("\r", "\n")
    lines = _without_marks_of_rows(text).split("\n")
    numbered = [(i, line) for i, line in enumerate(lines, 1) if line and not line.isspace()]
    body = [(i, line) for i, line in numbered if not line.lstrip().startswith(COMMENTS)]
    if not body:
        raise InputError("data", source, "the file is empty; a table of times and values is needed")
    check_rows(len(body) - PREAMBLE, source)
    chosen = _format(body)
    rows = [chosen.row(*line) for line in body]
    shape = shape_of(rows)
    if chosen.separator is None and shape.n < len(rows):
        rows, shape = _fixed_width(body, chosen, rows, shape)
    first, last, notes = bounds(rows, shape, source)
    above = list(islice(_above(numbered, rows[first].line, chosen), HEADER_LINES))
    sample = [lines[row.line - 1] for row in rows[first : min(last, first + SAMPLED)]]
    if chosen.decimal == ",":
        _check_thousands(sample, chosen, source)
        notes.append("commas are read as decimal marks")
    elif chosen.separator == ",":
        _check_commas(sample, len(shape.texts), above[0] if above else None, source)
    return make_table(rows[first:last], shape, heading_above(above, shape), notes)


def _without_marks_of_rows(text: str) -> str:
    """Return a matrix as MATLAB and others write it, ``[1 2; 3 4];``, as rows: a semicolon that only ends rows goes."""
    ends, matrix = re.compile(r";[ \t]*$", re.M), re.match(r"((?:\s*[#%!/].*\n)*)\s*(?:\w+\s*=\s*)?\[", text)
    if matrix and (inside := text[matrix.end() :].rstrip(" \t\n;")).endswith("]"):
        return matrix[1] + ends.sub("", inside[:-1]).replace(";", "\n")
    rows = re.findall(r"^.*\d.*$", text[:HEAD_LETTERS], re.M)[:-1]
    return ends.sub("", text) if rows and all(row.count(";") == 1 and ends.search(row) for row in rows) else text


def _check_shape(data: bytes, source: object) -> None:
    """Refuse what is too long or too wide to be a record before it takes ten times its size in memory."""
    check_rows(max(data.count(b"\n"), data.count(b"\r")) - PREAMBLE, source)
    check_values(max(map(data.count, (b",", b";", b"\t"))), source)
    letters = np.frombuffer(data, np.uint8)
    ends = np.flatnonzero((letters == ord("\n")) | (letters == ord("\r")))
    longest = int(np.max(np.diff(ends, prepend=-1, append=letters.size)))
    if longest > LONGEST_LINE:
        remedy = f"a line of {longest} bytes; at most {LONGEST_LINE}, a row has a few columns"
        raise InputError("data", source, remedy)


def decode(data: bytes, source: object) -> str:
    """Return the text of bytes in UTF-8, UTF-16 (with a mark or without) or Windows-1252; raises InputError."""
    head = data[:LOOKED_AT]
    encodings = [name for name, mark in MARKS if data.startswith(mark)]
    if not encodings and len(data) % 2 == 0:
        zeros = [head[k::2].count(0) / max(1, len(head) // 2) for k in (0, 1)]
        encodings = ["utf-16-le"] if zeros[1] > 0.4 > zeros[0] else ["utf-16-be"] if zeros[0] > 0.4 > zeros[1] else []
    for encoding in encodings or ["utf-8", "cp1252", "latin-1"]:
        try:
            text = data.decode(encoding).rstrip("\x00")  # loggers fill up a block with zeros
        except UnicodeDecodeError:
            continue
        if not re.search(r"[\x00-\x08\x0e-\x19\x1b-\x1f\x7f]", text):
            return text.replace("\x1a", "")
    kinds = "text, xlsx, xls, mat, npz, npy, Parquet, UFF 58, TDMS or wav"
    raise InputError("data", source, f"it is a binary file of no known kind; {kinds} is read")


def _format(body: Sequence[tuple[int, str]]) -> Format:
    """Return the separator and decimal mark under which most rows are alike, of those with the least text in them.

    A single column with decimal commas is not among them: its commas may as well separate two.
    """
    sample = body
    if len(body) > SAMPLED:
        starts = [len(body) * k // 4 for k in (1, 2, 3)]
        sample = [line for start in starts for line in body[start : start + BLOCK]]
    shapes = {form: shape_of([form.row(*line) for line in sample]) for form in FORMATS}
    possible = {form: shape for form, shape in shapes.items() if form.decimal == "." or len(shape.texts) > 1}
    most = max(shape.n for shape in possible.values())
    good = [form for form, shape in possible.items() if shape.numeric and shape.n >= 0.9 * most]
    best = min(good, key=lambda form: (sum(map(bool, shapes[form].texts)), -shapes[form].numeric), default=BLANKS)
    return best if len(shapes[best].texts) > 1 else BLANKS


def _fixed_width(
    body: Sequence[tuple[int, str]], form: Format, rows: list[TableRow], shape: RowShape
) -> tuple[list[TableRow], RowShape]:
    """Return rows cut where no line has a character, where that makes more of them alike: blanks may be missing."""
    numbers = [not any(isinstance(cell, str) for cell in row.cells) for row in rows]
    lines = [line for (_, line), number in zip(body, numbers, strict=True) if number]
    used = bytearray(max(map(len, lines), default=0))
    for line in lines:
        for match in re.finditer(r"\S+", line):
            used[match.start() : match.end()] = b"x" * (match.end() - match.start())
    cuts = [match.span() for match in re.finditer(rb"x+", used)]
    widest = max((len(row.cells) for row, number in zip(rows, numbers, strict=True) if number), default=0)
    if len(cuts) != widest or any("\t" in line for line in lines):
        return rows, shape
    cut = [
        form.row_of(i, [line[a:b] for a, b in cuts]) if number else row
        for (i, line), row, number in zip(body, rows, numbers, strict=True)
    ]
    longer = shape_of(cut)
    return (cut, longer) if longer.n > shape.n else (rows, shape)


def _above(numbered: Sequence[tuple[int, str]], first: int, form: Format) -> Iterator[Above]:
    """Yield the lines above line number ``first``, nearest first."""
    for i in range(bisect_left(numbered, first, key=lambda item: item[0]) - 1, -1, -1):
        line = numbered[i][1].strip()
        comment = line.startswith(COMMENTS)
        yield Above(_splits(line.lstrip("".join(COMMENTS)).strip() if comment else numbered[i][1], form), comment)


def _splits(line: str, form: Format) -> list[list[str]]:
    """Return the ways to cut a header: as the table is, by wide blanks, by blanks outside brackets, by others."""
    wide = re.split(r"\s{2,}|\t", line.strip())
    if form.separator is not None:
        ways = [form.fields(line), wide]
    else:
        ways = [wide, re.findall(r"[^\s\[(]+(?:\s*[\[(][^\])]*[\])])?", line)]
        if not re.search(r"[\[(]", line):
            ways.append(form.fields(line))
    return ways + [Format(separator, ".").fields(line) for separator in (",", ";", "\t")]


def _check_thousands(sample: Sequence[str], form: Format, source: object) -> None:
    """Refuse numbers that all look like 1,234."""
    found = [text.strip() for line in sample for text in form.fields(line) if "," in text]
    if found and all(THOUSANDS.fullmatch(text) for text in found):
        raise InputError("data", source, f"{found[0]} may mean thousands or decimals; write it as 1.234 or as 1234")


def _check_commas(sample: Sequence[str], width: int, above: Above | None, source: object) -> None:
    """Refuse ``0,5`` where it may be one number as well as two: whole numbers in pairs, and no header that fits."""
    cells = [[text.strip() for text in line.split(",")] for line in sample]
    pairs = [pair for row in cells for pair in zip(row[::2], row[1::2], strict=False)]
    if width % 2 or not all(re.fullmatch(r"[+-]?\d+", a) and re.fullmatch(r"\d+", b) for a, b in pairs):
        return
    names = len([cell for cell in above.splits[0] if cell.strip()]) if above else 0
    firsts = [int(a) for a, _ in pairs]
    counts = all(a < b for a, b in pairwise(firsts))
    if names == width // 2 or (not names and width == 2 and not counts):
        remedy = f"{sample[0].strip()} may be {width} numbers or half as many with decimal commas"
        raise InputError("data", source, f"{remedy}; write decimal points, or a header with a name for each column")
