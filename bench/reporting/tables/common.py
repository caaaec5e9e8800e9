"""What the tables share: the metrics that methods are ranked on, notes on failures, Markdown, LaTeX and CSV."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from csv import writer as csv_writer
from typing import Any

from tabulate import tabulate

from bench.contract.estimate import Status
from bench.reporting.frame import Result
from bench.scoring.comparison import Standing, standing

PRIMARY = ("k_over_m_error_pct", "c_over_m_error_pct", "rmse")
"""The metrics that methods are ranked on in Tables 2 to 5: what the data tell."""
Line = Mapping[str, Any]
"""A line of a tidy table: its values by column."""
Rows = tuple[list[list[str]], list[str]]
"""The rows of a table, and its headers."""


def ranked(results: Iterable[Result], metric: str) -> Standing | None:
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
        for row in result.rows if result.n_ok < result.n else ():
            if row.status is not Status.OK:
                text = f"{result.title}: {row.status.value}, {row.message}"
                notes[text] = notes.get(text, 0) + 1
    lines = [f"- {n} × {text}" for text, n in notes.items()]
    lines += [f"- {missing} cells were not run"] if missing else []
    return "\n".join(lines)


def bold(text: str, marked: bool) -> str:
    """A text as Markdown, in bold where it is marked."""
    return f"**{text}**" if marked else text


def markdown_table(rows: Sequence[Sequence[str]], headers: Sequence[str]) -> str:
    """A table of texts as Markdown."""
    return tabulate(rows, headers=headers, tablefmt="github", disable_numparse=True)


def latex_tables(captioned: Iterable[tuple[str, Rows]]) -> str:
    """Tables of Markdown's cells as LaTeX (booktabs), for an article, each under its caption."""
    tables = "".join(_latex_table(caption, *table) for caption, table in captioned)
    return f"% needs the package booktabs\n% regenerate: python -m bench.tables\n{tables}"


def _latex_table(caption: str, rows: Sequence[Sequence[str]], headers: Sequence[str]) -> str:
    body = tabulate(rows, headers, tablefmt="latex_booktabs", disable_numparse=True)
    body = re.sub(r"\*\*(.+?)\*\*", r"\\textbf{\1}", body.replace("×", r"$\times$").replace("é", r"\'e"))
    for plain, escaped in (("é", r"\'e"), ("%", r"\%"), ("_", r"\_")):
        caption = caption.replace(plain, escaped)
    return f"\\begin{{table}}\n\\centering\n\\small\n\\caption{{{caption}}}\n{body}\n\\end{{table}}\n"


def csv(lines: Sequence[Line], digits: int = 6, columns: Sequence[str] | None = None) -> str:
    """Lines as CSV, numbers with so many significant digits, nothing for what is NaN or not there."""
    names = columns or dict.fromkeys(name for line in lines for name in line)
    text = io.StringIO()
    writer = csv_writer(text, lineterminator="\n")
    writer.writerow(names)
    for line in lines:
        values = map(line.get, names)
        writer.writerow([_rounded(value, digits) if isinstance(value, float) else value for value in values])
    return text.getvalue()


def _rounded(value: float, digits: int) -> str:
    return "" if math.isnan(value) else f"{value:.{digits}g}"
