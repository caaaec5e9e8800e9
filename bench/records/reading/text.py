"""Records written as text: the encoding, the separator and the decimal mark are found in the file itself."""

from __future__ import annotations

import csv
import re
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice, pairwise

import numpy as np

from bench.errors import InputError
from bench.records.reading.grid import (
    NAN,
    Above,
    Cell,
    Span,
    TableRow,
    cell_of,
    check_whole,
    heading_above,
    longest_run,
    make_table,
)
from bench.records.reading.table import Table, check_rows

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
DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eEdD][+-]?\d+)?|[+-]?\d+(?:[eEdD][+-]?\d+)?")
THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(?:,\d{3})+")


@dataclass(frozen=True)
class Format:
    """What stands between cells (None for blanks) and before the decimals."""

    separator: str | None
    decimal: str

    def fields(self, line: str) -> list[str]:
        """The cells of a line as text; quotes keep separators inside a cell."""
        if self.separator is None:
            return line.replace('"', " ").split()
        if '"' not in line:
            return line.split(self.separator)
        return next(csv.reader([line], delimiter=self.separator, skipinitialspace=True))

    def cells(self, line: str) -> tuple[list[Cell], bool]:
        """The cells of a line, and whether all are numbers; what is no number in this format is text."""
        if '"' not in line and "_" not in line and self._is_simple(line):
            texts = (line if self.decimal == "." else line.replace(",", ".")).split(self.separator)
            try:
                return [float(text) for text in texts], "n" not in line
            except ValueError:
                pass
            try:
                return [float(text) if text and not text.isspace() else NAN for text in texts], False
            except ValueError:
                pass
        return self.parsed(self.fields(line))

    def _is_simple(self, line: str) -> bool:
        """Whether a comma in a line is what the format says, and a point a decimal mark."""
        return self.decimal == "." or (self.separator != "," and "." not in line)

    def parsed(self, fields: Sequence[str]) -> tuple[list[Cell], bool]:
        """Cells from their text, and whether all are numbers."""
        cells = [self._cell(text) for text in fields]
        return cells, not any(isinstance(cell, str) or cell != cell for cell in cells)

    def _cell(self, text: str) -> Cell:
        if not text:
            return NAN
        if self.decimal == ".":
            return cell_of(text)
        plain = text.strip().replace("−", "-")
        if DECIMAL_COMMA.fullmatch(plain):
            return cell_of(plain.replace(",", "."))
        cell = cell_of(text)
        return cell if isinstance(cell, str) or cell != cell else text  # a point is no decimal mark here


BLANKS = Format(None, ".")
FORMATS = [
    *(Format(separator, decimal) for separator in (";", "\t", ",") for decimal in (".", ",")),
    BLANKS,
    Format(None, ","),
]


def read_text(data: bytes, source: object) -> Table:
    """The table in the bytes of a text.

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
    rows = _rows(body, chosen)
    span = longest_run(rows)
    if chosen.separator is None and span.n < len(rows):
        rows, span = _fixed_width(body, chosen, rows, span)
    span, notes = check_whole(rows, span, source)
    above = list(islice(_above(numbered, rows[span.first].line, chosen), HEADER_LINES))
    sample = [lines[row.line - 1] for row in rows[span.first : min(span.last, span.first + SAMPLED)]]
    if chosen.decimal == ",":
        _check_thousands(sample, chosen, source)
        notes.append("commas are read as decimal marks")
    elif chosen.separator == ",":
        _check_commas(sample, span, above[0] if above else None, source)
    return make_table(rows, span, heading_above(above, span), notes)


def _without_marks_of_rows(text: str) -> str:
    """Return a matrix as MATLAB and others write it, ``[1 2; 3 4];``, as rows: a semicolon that only ends rows goes."""
    ends, matrix = re.compile(r";[ \t]*$", re.M), re.match(r"((?:\s*[#%!/].*\n)*)\s*(?:\w+\s*=\s*)?\[", text)
    if matrix and "]" in text:
        inside = ends.sub("", text[matrix.end() : text.rindex("]")])
        return matrix[1] + inside.replace(";", "\n") if re.search(r"\d", inside) else text
    rows = re.findall(r"^.*\d.*$", text[:HEAD_LETTERS], re.M)[:-1]
    return ends.sub("", text) if rows and all(row.count(";") == 1 and ends.search(row) for row in rows) else text


def _check_shape(data: bytes, source: object) -> None:
    """Refuse what is too long or too wide to be a record before it takes ten times its size in memory."""
    check_rows(max(data.count(b"\n"), data.count(b"\r")) - PREAMBLE, source)
    letters = np.frombuffer(data, np.uint8)
    ends = np.flatnonzero((letters == ord("\n")) | (letters == ord("\r")))
    longest = int(np.max(np.diff(ends, prepend=-1, append=letters.size)))
    if longest > LONGEST_LINE:
        remedy = f"a line of {longest} bytes; at most {LONGEST_LINE}, a row has a few columns"
        raise InputError("data", source, remedy)


def decode(data: bytes, source: object) -> str:
    """The text of bytes in UTF-8, UTF-16 (with a mark or without) or Windows-1252; raises InputError for others."""
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


def _rows(body: Sequence[tuple[int, str]], form: Format) -> list[TableRow]:
    return [TableRow(i, *form.cells(line)) for i, line in body]


def _format(body: Sequence[tuple[int, str]]) -> Format:
    """The separator and decimal mark under which most rows are alike, of those with the least text in them.

    A single column with decimal commas is not among them: its commas may as well separate two.
    """
    sample = body
    if len(body) > SAMPLED:
        starts = [len(body) * k // 4 for k in (1, 2, 3)]
        sample = [line for start in starts for line in body[start : start + BLOCK]]
    spans = {form: longest_run(_rows(sample, form)) for form in FORMATS}
    possible = {form: span for form, span in spans.items() if form.decimal == "." or len(span.texts) > 1}
    most = max(span.n for span in possible.values())
    good = [form for form, span in possible.items() if span.numeric and span.n >= 0.9 * most]
    if not good:
        return FORMATS[0]
    best = min(good, key=lambda form: (sum(map(bool, spans[form].texts)), -spans[form].numeric))
    return best if len(spans[best].texts) > 1 else BLANKS


def _fixed_width(
    body: Sequence[tuple[int, str]], form: Format, rows: list[TableRow], span: Span
) -> tuple[list[TableRow], Span]:
    """Rows cut where no line has a character, where that makes more rows alike: blanks may be missing values."""
    lines = [line for (_, line), row in zip(body, rows, strict=True) if _is_numeric(row)]
    used = bytearray(max(map(len, lines), default=0))
    for line in lines:
        for match in re.finditer(r"\S+", line):
            used[match.start() : match.end()] = b"x" * (match.end() - match.start())
    cuts = [match.span() for match in re.finditer(rb"x+", used)]
    widest = max((len(row.cells) for row in rows if _is_numeric(row)), default=0)
    if len(cuts) != widest or any("\t" in line for line in lines):
        return rows, span
    cut = [
        TableRow(i, *form.parsed([line[a:b] for a, b in cuts])) if _is_numeric(row) else row
        for (i, line), row in zip(body, rows, strict=True)
    ]
    longer = longest_run(cut)
    return (cut, longer) if longer.n > span.n else (rows, span)


def _is_numeric(row: TableRow) -> bool:
    return not any(isinstance(cell, str) for cell in row.cells)


def _above(numbered: Sequence[tuple[int, str]], first: int, form: Format) -> Iterator[Above]:
    """The lines above line number ``first``, nearest first."""
    for i in range(bisect_left(numbered, first, key=lambda item: item[0]) - 1, -1, -1):
        line = numbered[i][1].strip()
        comment = line.startswith(COMMENTS)
        yield Above(_splits(line.lstrip("".join(COMMENTS)).strip() if comment else numbered[i][1], form), comment)


def _splits(line: str, form: Format) -> list[list[str]]:
    """The ways to cut a header into cells: as the table is, by wide blanks, by blanks outside brackets, by others."""
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


def _check_commas(sample: Sequence[str], span: Span, above: Above | None, source: object) -> None:
    """Refuse ``0,5`` where it may be one number as well as two: whole numbers in pairs, and no header that fits."""
    cells = [[text.strip() for text in line.split(",")] for line in sample]
    pairs = [pair for row in cells for pair in zip(row[::2], row[1::2], strict=False)]
    if len(span.texts) % 2 or not all(re.fullmatch(r"[+-]?\d+", a) and re.fullmatch(r"\d+", b) for a, b in pairs):
        return
    names = len([cell for cell in above.splits[0] if cell.strip()]) if above else 0
    firsts = [int(a) for a, _ in pairs]
    counts = all(a < b for a, b in pairwise(firsts))
    if names == len(span.texts) // 2 or (not names and len(span.texts) == 2 and not counts):
        remedy = f"{sample[0].strip()} may be {len(span.texts)} numbers or half as many with decimal commas"
        raise InputError("data", source, f"{remedy}; write decimal points, or a header with a name for each column")
