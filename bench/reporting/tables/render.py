"""What every table is made with: rows by a specification of what is shown, and files as Markdown, CSV and LaTeX."""

from __future__ import annotations

import re
import textwrap
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from bench.contract.estimate import Status
from bench.reporting.frame import Frame, Line, Result, group
from bench.reporting.labels import title
from bench.reporting.rounding import readable
from bench.reporting.terminal import width as width_of

Item = TypeVar("Item")
Columns = Mapping[str, Callable[[Item], str]]
"""By heading, the text of an item."""
Rows = tuple[list[list[str]], list[str]]
"""The rows of a table, and its headers."""
Texts = Mapping[str, str]
"""By heading, what stands in a row."""
MISSING = "-"
"""What stands for an item that is not there."""


def listing(items: Iterable[Item], columns: Columns[Item]) -> Rows:
    """A row an item."""
    return [[text(item) for text in columns.values()] for item in items], list(columns)


def named(line: Line) -> Texts:
    """The method of a line, which begins its row."""
    return {"method": title(line["method"])}


def each(name: Callable[[Item], str], columns: Columns[Item]) -> Callable[[Item], Texts]:
    """What an item shows under headings that begin with a name, which stand side by side by name."""
    return lambda item: {f"{name(item)} {heading}": text(item) for heading, text in columns.items()}


def measured(line: Line) -> str:
    """The quantity of a line, for a heading."""
    return readable(line["quantity"])


@dataclass(frozen=True)
class Panel:
    """What is shown of lines, side by side in rows.

    Attributes:
        entry: What a line adds to its row, under headings of its own.
        row: What begins a row; lines of the same beginning stand in one.
        last: What ends a row, by its lines.
        title: What is said above; what the first line holds stands in braces.
        of: Which lines it shows.
        order: What sorts them.
    """

    entry: Callable[[Any], Texts]
    row: Callable[[Any], Texts] = named
    last: Callable[[Sequence[Any]], Texts] = lambda lines: {}
    title: str = ""
    of: Callable[[Any], bool] = lambda line: True
    order: Callable[[Any], Any] = lambda line: 0

    def rows(self, lines: Iterable[Any]) -> Rows:
        """The rows of lines; columns in which nothing stands are left out, and all where no entry is left."""
        import pandas as pd

        by_row = group(sorted(filter(self.of, lines), key=self.order), lambda line: tuple(self.row(line).items()))
        entries = pd.DataFrame([self.entry(line) for lines in by_row.values() for line in lines])
        place = [i for i, lines in enumerate(by_row.values()) for _ in lines]
        starts, ends = pd.DataFrame(map(dict, by_row)), pd.DataFrame(map(self.last, by_row.values()))
        whole = pd.concat([starts, entries.groupby(place).first(), ends], axis=1).fillna(MISSING)
        shown = whole.loc[:, ~whole.isin([MISSING, ""]).all()]
        return (shown.to_numpy().tolist(), list(shown)) if set(shown) & set(entries) else ([], [])


@dataclass(frozen=True)
class TableForm:
    """The table of an experiment: the lines of its CSV, and what of them is shown.

    Attributes:
        legend: What is said above it; what its experiment states stands in braces.
        columns: Of the CSV.
        lines: Makes the lines of the results.
        section: The heading under which a line stands.
        panels: What is shown of the lines of a section.
        notes: What is said below a section.
        needs: Which results it is about; without one of them in the store, it is not written.
        in_csv: Whether a line stands in the CSV.
        digits: Significant digits of its numbers.
        latex: Whether the first panels are written in LaTeX, too.
    """

    legend: str
    columns: Sequence[str]
    lines: Callable[[Frame], list[Line]]
    section: Callable[[Line], str]
    panels: Sequence[Panel]
    notes: Callable[[Sequence[Line]], Iterable[str]] = lambda lines: ()
    needs: Callable[[Result], bool] = lambda result: True
    in_csv: Callable[[Line], bool] = lambda line: True
    digits: int = 6
    latex: bool = False

    def files(self, frame: Frame) -> dict[str, str]:
        """The files by name; none where the store holds no cell that it is about."""
        if not any(result.stored and self.needs(result) for result in frame):
            return {}
        lines, captioned = self.lines(frame), list[tuple[str, Rows]]()
        legend = self.legend.format(name=frame.experiment, **frame.table)
        title = f"# Table {frame.number}. {frame.title}" if frame.number else f"# {frame.title}"
        parts: list[str | Rows] = [title, textwrap.fill(legend, 120, break_on_hyphens=False)]
        for heading, members in group(lines, self.section).items():
            shown = [(panel.title.format(**members[0]), panel.rows(members)) for panel in self.panels]
            captioned.append((f"{frame.title}. {heading}", shown[0][1]))
            parts += [f"## {heading}", *(part for both in shown if any(both[1]) for part in both), *self.notes(members)]
        noted = [] if any(self.notes(lines)) else [failure_notes(frame)]
        parts += [*noted, frame.footer]
        latex = captioned if self.latex else ()
        return files(frame.name, parts, filter(self.in_csv, lines), self.columns, self.digits, latex)


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
        lines: Those of the CSV, nothing for what is NaN or not there.
        columns: Of the CSV; all that the lines have, without.
        digits: Significant digits of its numbers.
        latex: Captions with rows, for an article.
    """
    import pandas as pd

    texts = [part if isinstance(part, str) else markdown_table(*part) for part in parts if any(part)]
    data = pd.DataFrame(list(lines), columns=columns)
    csv = data.to_csv(index=False, float_format=f"%.{digits}g", lineterminator="\n")
    found = {f"{name}.md": "\n\n".join(texts) + "\n", f"{name}.csv": csv}
    return {**found, f"{name}.tex": latex_tables(latex)} if latex else found


def failure_notes(results: Iterable[Result]) -> str:
    """What failed, how often and with what sentence, as a list; empty where nothing did."""
    known = list(dict.fromkeys(results))
    notes = Counter(
        f"{result.title}: {status.value}, {message}"
        for result in known
        for status, message in zip(result.statuses, result.messages, strict=True)
        if status is not Status.OK
    )
    missing = sum(result.stored is None for result in known)
    return "\n".join(
        [f"- {n} × {text}" for text, n in notes.items()] + [f"- {missing} cells were not run"] * (missing > 0)
    )


def bold(text: str, marked: bool) -> str:
    """A text as Markdown, in bold where it is marked."""
    return f"**{text}**" if marked else text


def markdown_table(rows: Sequence[Sequence[str]], headers: Sequence[str]) -> str:
    """Return a table of texts as Markdown, filled up to the width of its columns."""
    columns = [[text.strip() for text in column] for column in zip(headers, *rows, strict=True)]
    widths = [max(width_of(column[0]) + 2, *map(width_of, column)) for column in columns]
    lines = [
        [text + " " * (width - width_of(text)) for text, width in zip(line, widths, strict=True)]
        for line in zip(*columns, strict=True)
    ]
    head, *body = [f"| {' | '.join(line)} |" for line in lines]
    return "\n".join([head, f"|{'|'.join('-' * (width + 2) for width in widths)}|", *body])


LATEX = str.maketrans(
    {
        **{sign: f"\\{sign}" for sign in "&%$#_{}"}, "^": r"\^{}", "~": r"\textasciitilde{}", "\\": r"\textbackslash{}",
        "<": r"\ensuremath{<}", ">": r"\ensuremath{>}", "×": r"$\times$", "é": r"\'e",
    }
)  # fmt: skip
"""Signs with a meaning in LaTeX, or that it has no letter for, as LaTeX prints them."""


def latex_tables(captioned: Iterable[tuple[str, Rows]]) -> str:
    """Tables of Markdown's cells as LaTeX (booktabs), for an article, each under its caption."""
    parts = ["% needs the package booktabs", "% regenerate: python -m bench tables"]
    for caption, (rows, headers) in captioned:
        head, *body = [" & ".join(map(_latex, line)) + r" \\" for line in (headers, *rows)]
        parts += [r"\begin{table}", r"\centering", r"\small", f"\\caption{{{_latex(caption)}}}"]
        parts += [f"\\begin{{tabular}}{{{'l' * len(headers)}}}", r"\toprule", head, r"\midrule", *body]
        parts += [r"\bottomrule", r"\end{tabular}", r"\end{table}"]
    return "\n".join(parts) + "\n"


def _latex(text: str) -> str:
    return re.sub(r"\*\*(.+?)\*\*", r"\\textbf{\1}", text.translate(LATEX))
