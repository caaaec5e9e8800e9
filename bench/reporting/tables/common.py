"""What the tables share: the metrics that methods are ranked on, notes on failures, Markdown, LaTeX and CSV."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from csv import writer as csv_writer
from typing import Any

from bench.contract.estimate import Status
from bench.reporting.frame import Result
from bench.reporting.terminal import width as width_of
from bench.scoring.comparison import ScenarioRanking, standing

PRIMARY = ("k_over_m_error_pct", "c_over_m_error_pct", "rmse")
"""The metrics that methods are ranked on in Tables 2 to 5: what the data tell."""
Line = Mapping[str, Any]
"""A line of a tidy table: its values by column."""
Rows = tuple[list[list[str]], list[str]]
"""The rows of a table, and its headers."""


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


def latex_tables(captioned: Iterable[tuple[str, Rows]]) -> str:
    """Tables of Markdown's cells as LaTeX (booktabs), for an article, each under its caption."""
    tables = "".join(_latex_table(caption, *table) for caption, table in captioned)
    return f"% needs the package booktabs\n% regenerate: python -m bench tables\n{tables}"


LATEX = str.maketrans(
    {
        **{sign: f"\\{sign}" for sign in "&%$#_{}"}, "^": r"\^{}", "~": r"\textasciitilde{}", "\\": r"\textbackslash{}",
        "<": r"\ensuremath{<}", ">": r"\ensuremath{>}", "×": r"$\times$", "é": r"\'e",
    }
)  # fmt: skip
"""Signs with a meaning in LaTeX, or that it has no letter for, as LaTeX prints them."""


def _latex_table(caption: str, rows: Sequence[Sequence[str]], headers: Sequence[str]) -> str:
    head, *body = (
        f" {' & '.join(re.sub(BOLD, TEXTBF, text.translate(LATEX)) for text in line)} \\\\"
        for line in _aligned(rows, headers)
    )
    columns = "l" * len(headers)
    lines = (
        r"\begin{table}", r"\centering", r"\small", f"\\caption{{{caption.translate(LATEX)}}}",
        f"\\begin{{tabular}}{{{columns}}}", r"\toprule", head, r"\midrule", *body, r"\bottomrule", r"\end{tabular}",
        r"\end{table}",
    )  # fmt: skip
    return "\n".join(lines) + "\n"


BOLD, TEXTBF = r"\*\*(.+?)\*\*", r"\\textbf{\1}"
"""Bold in Markdown and in LaTeX."""


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
