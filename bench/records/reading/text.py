"""Reader of text files, with detection of the encoding, the separator and the decimal mark."""

from __future__ import annotations

import csv
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

from bench.errors import InputError
from bench.records.reading.grid import Cell, LineAbove, TableRow, bounds_of, make_table, row_of, shape_of
from bench.records.reading.table import PREAMBLE, Table, check_size

COMMENTS = ("#", "%", "!", "//")
LOOKED_AT = 4096
HEAD_LETTERS = 100_000
"""Number of first characters that are examined for semicolons at the ends of rows."""
SAMPLED = 3000
"""Approximate number of lines, distributed over the file, by which its format is determined."""
LONGEST_LINE = 32_768
THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(?:,\d{3})+")
Lines = Sequence[tuple[int, str]]
"""Lines and their numbers in the file."""


class Format(NamedTuple):
    """Separator of cells (None for blanks) and decimal mark."""

    separator: str | None
    decimal: str

    def fields(self, line: str) -> list[str]:
        """Return the cells of a line as text; separators inside quotes do not separate."""
        if self.separator is None:
            return line.replace('"', " ").split()
        if '"' not in line:
            return line.split(self.separator)
        return next(csv.reader([line], delimiter=self.separator, skipinitialspace=True))

    def row(self, number: int, line: str) -> TableRow:
        """Return the row of a line; cells that are not numbers in this format are texts."""
        simple = line
        if self.decimal == ",":
            simple = '"' if "." in line or self.separator == "," else line.replace(",", ".")
        if not any(letter in simple for letter in '"_n'):  # the fast path for rows of numbers
            with suppress(ValueError):
                cells: list[Cell] = [float(text) for text in simple.split(self.separator)]
                return TableRow(number, cells, sys.intern("n" * len(cells)))
        return row_of(number, self.fields(line), self.decimal)


BLANKS = Format(None, ".")
FORMATS = [Format(separator, decimal) for separator in (";", "\t", ",", None) for decimal in (".", ",")]


def read_text(data: bytes, source: object) -> Table:
    """Return the table in the bytes of a text.

    Raises:
        InputError: The file is not a text, has no table, or is ambiguous.
    """
    text = decode(data, source).replace("\r\n", "\n").replace("\r", "\n")
    lines = _without_row_ends(text).split("\n")
    if (longest := max(map(len, lines))) > LONGEST_LINE:
        remedy = f"a line has {longest} characters; at most {LONGEST_LINE} are allowed"
        raise InputError("data", source, remedy)
    body = [(i, line) for i, line in enumerate(lines, 1) if line.strip() and not _is_comment(line)]
    if not body:
        raise InputError("data", source, "the file is empty; a table of times and values is needed")
    check_size(len(body) - PREAMBLE, source)
    form = format_of(body)
    rows = [form.row(*line) for line in body]
    shape = shape_of(rows)
    first, last = bounds_of(rows, shape, source)
    above = _above(lines[: rows[first].line - 1], form)
    table = make_table(rows, shape, (first, last), above, source)
    sample = [lines[row.line - 1] for row in rows[first:last][:SAMPLED]]
    if form.decimal == ",":
        _check_thousands(sample, form, source)
        return replace(table, notes=(*table.notes, "commas were read as decimal marks"))
    if form.separator == ",":
        _check_commas(sample, len(shape.kinds), next(_above(lines[: rows[first].line - 1], form), None), source)
    return table


def decode(data: bytes, source: object) -> str:
    """Decode bytes in UTF-8, UTF-16 (with or without a byte-order mark) or Windows-1252; raises InputError."""
    zeros = [data[k:LOOKED_AT:2].count(0) > 0.4 * len(data[k:LOOKED_AT:2]) for k in (0, 1)]
    encodings = ["utf-8-sig", "cp1252", "latin-1"]
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        encodings = ["utf-16"]
    elif len(data) % 2 == 0 and zeros[0] != zeros[1]:
        encodings = ["utf-16-le" if zeros[1] else "utf-16-be"]
    for encoding in encodings:
        with suppress(UnicodeDecodeError):
            text = data.decode(encoding).rstrip("\0")  # some loggers pad blocks with zeros
            if not re.search(r"[\x00-\x08\x0e-\x19\x1b-\x1f\x7f]", text):
                return text.replace("\x1a", "")
    kinds = "text, xlsx, xls, mat, npz, npy, Parquet, UFF 58, TDMS or wav"
    raise InputError("data", source, f"unknown binary format; supported: {kinds}")


def _without_row_ends(text: str) -> str:
    """Remove semicolons and brackets of a matrix in MATLAB syntax, ``[1 2; 3 4];``, and semicolons that end rows."""
    ends, matrix = re.compile(r";[ \t]*$", re.M), re.match(r"((?:\s*[#%!/].*\n)*)\s*(?:\w+\s*=\s*)?\[", text)
    if matrix and (inside := text[matrix.end() :].rstrip(" \t\n;")).endswith("]"):
        return matrix[1] + ends.sub("", inside[:-1]).replace(";", "\n")
    rows = re.findall(r"^.*\d.*$", text[:HEAD_LETTERS], re.M)[:-1]
    return ends.sub("", text) if rows and all(row.count(";") == 1 and ends.search(row) for row in rows) else text


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(COMMENTS)


def format_of(body: Lines) -> Format:
    """Return the separator and decimal mark for which most rows have equal shapes, with the fewest texts.

    A single column with decimal commas is excluded, as its commas may separate two columns.
    """
    sample = body[:: 1 + len(body) // SAMPLED]
    shapes = {form: shape_of([form.row(*line) for line in sample]) for form in FORMATS}
    possible = {form: shape for form, shape in shapes.items() if form.decimal == "." or len(shape.kinds) > 1}
    most = max(shape.n for shape in possible.values())
    good = [form for form, shape in possible.items() if shape.n and shape.n >= 0.9 * most]
    best = min(good, key=lambda form: (shapes[form].kinds.count("w"), -shapes[form].kinds.count("n")), default=BLANKS)
    return best if len(shapes[best].kinds) > 1 else BLANKS


def _above(lines: Sequence[str], form: Format) -> Iterator[LineAbove]:
    """Yield the lines above a table, nearest first, divided as the table, at wide blanks, or at other separators."""
    for line in filter(str.strip, reversed(lines)):
        text = line.strip().lstrip("".join(COMMENTS)).strip() if _is_comment(line) else line
        wide = re.split(r"\s{2,}|\t", text.strip())
        tokens = re.findall(r"[^\s\[(]+(?:\s*[\[(][^\])]*[\])])?", text.replace('"', " "))
        ways = [wide, tokens] if form.separator is None else [form.fields(text), wide]
        yield LineAbove(ways + [Format(other, ".").fields(text) for other in (",", ";", "\t")], _is_comment(line))


def _check_thousands(sample: Sequence[str], form: Format, source: object) -> None:
    """Raise InputError if all numbers look like 1,234."""
    commas = [text.strip() for line in sample for text in form.fields(line) if "," in text]
    if commas and all(map(THOUSANDS.fullmatch, commas)):
        raise InputError("data", source, f"the comma of {commas[0]} is ambiguous; write 1.234 or 1234")


def _check_commas(sample: Sequence[str], width: int, above: LineAbove | None, source: object) -> None:
    """Raise InputError if ``0,5`` may be one number or two: pairs of whole numbers without a fitting header."""
    cells = [[text.strip() for text in line.split(",")] for line in sample]
    pairs = [pair for row in cells for pair in zip(row[::2], row[1::2], strict=False)]
    if width % 2 or not all(re.fullmatch(r"[+-]?\d+", a) and re.fullmatch(r"\d+", b) for a, b in pairs):
        return
    names = len([cell for cell in above.ways[0] if cell.strip()]) if above else 0
    counts = all(int(a) < int(b) for (a, _), (b, _) in pairwise(pairs))
    if names == width // 2 or (not names and width == 2 and not counts):
        remedy = f"{sample[0].strip()} is ambiguous: {width} numbers, or half as many with decimal commas"
        raise InputError("data", source, f"{remedy}; use decimal points, or a header with a name for each column")
