"""What every table is made with: rows from a specification of its columns, and its files as Markdown, CSV and LaTeX.

A table says which items (lines of the frame, or results) stand in a row, which of these side by side, and what is shown
of each: a mapping of headings to functions that return a text. :func:`panel` and :func:`listing` make the rows.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from typing import Any, TypeVar

from bench.contract.estimate import Status
from bench.reporting.frame import Frame, Line, Result, group
from bench.reporting.labels import title
from bench.reporting.terminal import width as width_of
from bench.scoring.comparison import ScenarioRanking, standing

PRIMARY = ("k_over_m_error_pct", "c_over_m_error_pct", "rmse")
"""The metrics that methods are ranked on in Tables 2 to 5: what the data tell."""
Item = TypeVar("Item")
Columns = Mapping[str, Callable[[Item], str]]
"""By heading, the text of an item."""
Rows = tuple[list[list[str]], list[str]]
"""The rows of a table, and its headers."""
MISSING = "-"
"""What stands for an item that is not there."""
NAMED: Columns[Sequence[Line]] = {"method": lambda own: title(own[0]["method"])}
NOISE: Columns[Sequence[Line]] = {"SNR (dB)": lambda own: f"{own[0]['snr_db']:g}"}
"""Columns that many tables begin with."""


def listing(items: Iterable[Item], columns: Columns[Item]) -> Rows:
    """A row an item."""
    return [[text(item) for text in columns.values()] for item in items], list(columns)


def texts(rows: Iterable[Mapping[str, str]], headers: Sequence[str]) -> Rows:
    """Rows of texts by heading; nothing where a row has none."""
    return [[row.get(name, "") for name in headers] for row in rows], list(headers)


def panel(
    items: Sequence[Item],
    row: Callable[[Item], Hashable],
    first: Columns[Sequence[Item]],
    across: Callable[[Item], Hashable],
    each: Callable[[Item], Columns[Item]],
    last: Columns[Sequence[Item]] | None = None,
    rest: str = MISSING,
    order: Callable[[Iterable[Any]], Iterable[Any]] = list,
) -> Rows:
    """A row for all items of which ``row`` is the same; ``each`` makes the columns of those that share ``across``.

    ``first`` and ``last`` are columns before and behind them, of all items of the row. ``each`` is given any item that
    stands there; where a row has none, a dash stands in the first of its columns, and ``rest`` in the others. ``order``
    puts the rows in order.
    """
    places, last = {key: each(own[0]) for key, own in group(items, across).items()}, last or {}
    rows, by_row = [], group(items, row)
    for own in (by_row[key] for key in order(by_row)):
        at, cells = {across(item): item for item in reversed(own)}, [text(own) for text in first.values()]
        for key, columns in places.items():
            here = [text(at[key]) for text in columns.values()] if key in at else []
            cells += here or [MISSING, *[rest] * (len(columns) - 1)]
        rows.append([*cells, *(text(own) for text in last.values())])
    return rows, [*first, *(heading for columns in places.values() for heading in columns), *last]


def files(
    name: str,
    parts: Iterable[str | Rows],
    lines: Iterable[Line],
    columns: Sequence[str] | None = None,
    digits: int = 6,
    latex: Sequence[tuple[str, Rows]] = (),
) -> dict[str, str]:
    """The files of a table by name.

    Args:
        name: What they are called.
        parts: Paragraphs, headings and rows in order; empty ones are left out.
        lines: Those of the CSV.
        columns: Of the CSV; all that the lines have, without.
        digits: Significant digits of its numbers.
        latex: Captions with rows, for an article.
    """
    texts = [part if isinstance(part, str) else markdown_table(*part) for part in parts if part]
    found = {f"{name}.md": "\n\n".join(texts) + "\n", f"{name}.csv": csv(lines, digits, columns)}
    return {**found, f"{name}.tex": latex_tables(latex)} if latex else found


def csv(lines: Iterable[Line], digits: int = 6, columns: Sequence[str] | None = None) -> str:
    """Lines as CSV, nothing for what is NaN or not there."""
    import pandas as pd

    frame = pd.DataFrame(list(lines), columns=columns)
    return str(frame.to_csv(index=False, float_format=f"%.{digits}g", lineterminator="\n"))


def ranked(results: Iterable[Result], metric: str) -> ScenarioRanking | None:
    """Where the methods of one scenario stand by a metric; reference rows and cells that were not run left out."""
    own = {result.label: result for result in results if result.stored and not result.is_reference}
    return standing(
        {label: result.errors(metric) for label, result in own.items()},
        {label: result.excess(metric) for label, result in own.items()},
        next((result.bound(metric) for result in own.values()), math.nan),
    )


def failure_notes(results: Iterable[Result]) -> str:
    """What failed, how often and with what sentence, as a list; empty where nothing did."""
    notes: dict[str, int] = {}
    missing = 0
    for result in results:
        missing += result.stored is None
        for status, message in zip(result.statuses, result.messages, strict=True):
            if status is not Status.OK:
                text = f"{result.title}: {status.value}, {message}"
                notes[text] = notes.get(text, 0) + 1
    lines = [f"- {n} × {text}" for text, n in notes.items()]
    lines += [f"- {missing} cells were not run"] if missing else []
    return "\n".join(lines)


def ending(frame: Frame) -> list[str]:
    """The last parts of a table: what failed, and the command that makes it again."""
    notes = failure_notes(frame)
    return [f"## What failed\n\n{notes}" if notes else "", f"Regenerate: `{frame.command}`"]


def bold(text: str, marked: bool) -> str:
    """A text as Markdown, in bold where it is marked."""
    return f"**{text}**" if marked else text


def markdown_table(rows: Sequence[Sequence[str]], headers: Sequence[str]) -> str:
    """Return a table of texts as Markdown."""
    head, *body = _aligned(rows, headers)
    rule = ["-" * (width_of(text) + 2) for text in head]
    return "\n".join([_line(head), f"|{'|'.join(rule)}|", *map(_line, body)])


def _line(texts: Iterable[str]) -> str:
    return f"| {' | '.join(texts)} |"


HEADING_GAP = 2
"""Places by which a column is wider than its heading."""


def _aligned(rows: Iterable[Sequence[str]], headers: Sequence[str]) -> Iterator[tuple[str, ...]]:
    """Return the lines of a table, headings first, with every text filled up to the width of its column."""
    columns = []
    for column in zip(headers, *rows, strict=True):
        texts = [text.strip() for text in column]
        widths = list(map(width_of, texts))
        whole = max(widths[0] + HEADING_GAP, *widths)
        columns.append([text + " " * (whole - width) for text, width in zip(texts, widths, strict=True)])
    return zip(*columns, strict=True)


LATEX = str.maketrans(
    {
        **{sign: f"\\{sign}" for sign in "&%$#_{}"}, "^": r"\^{}", "~": r"\textasciitilde{}", "\\": r"\textbackslash{}",
        "<": r"\ensuremath{<}", ">": r"\ensuremath{>}", "×": r"$\times$", "é": r"\'e",
    }
)  # fmt: skip
"""Signs with a meaning in LaTeX, or that it has no letter for, as LaTeX prints them."""
BOLD, TEXTBF = r"\*\*(.+?)\*\*", r"\\textbf{\1}"
"""Bold in Markdown and in LaTeX."""


def latex_tables(captioned: Iterable[tuple[str, Rows]]) -> str:
    """Tables of Markdown's cells as LaTeX (booktabs), for an article, each under its caption."""
    tables = "".join(_latex_table(caption, *table) for caption, table in captioned)
    return f"% needs the package booktabs\n% regenerate: python -m bench tables\n{tables}"


def _latex_table(caption: str, rows: Sequence[Sequence[str]], headers: Sequence[str]) -> str:
    head, *body = (
        f" {' & '.join(re.sub(BOLD, TEXTBF, text.translate(LATEX)) for text in line)} \\\\"
        for line in _aligned(rows, headers)
    )
    lines = (
        r"\begin{table}", r"\centering", r"\small", f"\\caption{{{caption.translate(LATEX)}}}",
        f"\\begin{{tabular}}{{{'l' * len(headers)}}}", r"\toprule", head, r"\midrule", *body, r"\bottomrule",
        r"\end{tabular}", r"\end{table}",
    )  # fmt: skip
    return "\n".join(lines) + "\n"
