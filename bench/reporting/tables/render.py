"""Render tables: rows from a specification of their columns, and files in Markdown, CSV and LaTeX."""

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
"""Functions that format an item, by column heading."""
Rows = tuple[list[list[str]], list[str]]
"""Rows and headers of a table."""
Texts = Mapping[str, str]
"""Texts of a row, by column heading."""
MISSING = "-"
"""Text of an empty entry."""


def listing(items: Iterable[Item], columns: Columns[Item]) -> Rows:
    """Return one row per item."""
    return [[text(item) for text in columns.values()] for item in items], list(columns)


def named(line: Line) -> Texts:
    """Return the first entry of a row: the method."""
    return {"method": title(line["method"])}


def each(name: Callable[[Item], str], columns: Columns[Item]) -> Callable[[Item], Texts]:
    """Return a function that formats the columns of an item, with its name before each heading."""
    return lambda item: {f"{name(item)} {heading}": text(item) for heading, text in columns.items()}


def measured(line: Line) -> str:
    """Return the quantity of a line as it is printed in headings."""
    return readable(line["quantity"])


@dataclass(frozen=True)
class Panel:
    """Specification of a panel of a table: which lines it shows, and in which rows and columns.

    Attributes:
        entry: Texts that a line adds to its row.
        row: First texts of a row; lines with the same ones share it.
        last: Last texts of a row, from its lines.
        title: Sentence above the panel; values of the first line are inserted for names in braces.
        of: Whether the panel shows a line.
        order: Sort key of the lines.
    """

    entry: Callable[[Any], Texts]
    row: Callable[[Any], Texts] = named
    last: Callable[[Sequence[Any]], Texts] = lambda lines: {}
    title: str = ""
    of: Callable[[Any], bool] = lambda line: True
    order: Callable[[Any], Any] = lambda line: 0

    def rows(self, lines: Iterable[Any]) -> Rows:
        """Return the rows of lines, without empty columns; nothing if no entry is left."""
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
    """Specification of the table of an experiment.

    Attributes:
        legend: Text above the table; fields of the experiment's ``table`` are inserted for names in braces.
        columns: Columns of the CSV.
        lines: Returns the lines of a frame.
        section: Returns the heading of the section of a line.
        panels: Panels of each section.
        notes: Returns the notes below a section.
        needs: Whether a result is a subject of the table; without any in the store, the table is not written.
        in_csv: Whether a line is part of the CSV.
        digits: Significant digits in the CSV.
        latex: Whether the first panel of each section is written in LaTeX, too.
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
        """Return the files by name; none if no subject of the table is stored."""
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
    """Return the files of a table by name.

    Args:
        name: Name of the files, without their endings.
        parts: Paragraphs, headings and rows of the Markdown file, in order; empty ones are left out.
        lines: Lines of the CSV; NaN and missing values are empty.
        columns: Columns of the CSV; None for all columns of the lines.
        digits: Significant digits in the CSV.
        latex: Captions with their rows for the LaTeX file, which is left out if there are none.
    """
    import pandas as pd

    texts = [part if isinstance(part, str) else markdown_table(*part) for part in parts if any(part)]
    data = pd.DataFrame(list(lines), columns=columns)
    csv = data.to_csv(index=False, float_format=f"%.{digits}g", lineterminator="\n")
    by_name = {f"{name}.md": "\n\n".join(texts) + "\n", f"{name}.csv": csv}
    return {**by_name, f"{name}.tex": latex_tables(latex)} if latex else by_name


def scenario_sections(
    lines: Sequence[Line], described: Mapping[str, str], panel: Panel, order: Callable[[list[Line]], list[Line]],
    summary: Callable[[Sequence[Line]], str] = lambda scored: "",
) -> tuple[list[str | Rows], list[tuple[str, Rows]]]:  # fmt: skip
    """Return the sections of a track's table, one per scenario, and the rows of each by the scenario's name.

    Args:
        lines: One per scenario, method and quantity; a method without scores on a scenario has a line with a message.
        described: Descriptions of the scenarios, by name.
        panel: The panel of each scenario.
        order: Sorts the lines of a scenario.
        summary: Returns a sentence below the panel.
    """
    parts: list[str | Rows] = []
    shown: list[tuple[str, Rows]] = []
    for scenario, sentence in described.items():
        here = [line for line in lines if line["scenario"] == scenario]
        scored = order([line for line in here if "quantity" in line])
        rows = panel.rows(scored)
        shown += [(readable(scenario), rows)] if any(rows) else []
        parts += [f"## {readable(scenario)}", sentence, rows, summary(scored)]
        refused = group([line for line in here if "quantity" not in line], lambda line: line["message"])
        for message, members in refused.items():
            names = ", ".join(line.get("title", line["method"]) for line in members)
            parts.append(f"Not applicable: {names}: {message}.")
    return parts, shown


def failure_notes(results: Iterable[Result]) -> str:
    """List the failed fits with their counts and messages, as Markdown; empty if none failed."""
    distinct = list(dict.fromkeys(results))
    notes = Counter(
        f"{result.title}: {status.value}, {message}"
        for result in distinct
        for status, message in zip(result.statuses, result.messages, strict=True)
        if status is not Status.OK
    )
    missing = sum(result.stored is None for result in distinct)
    return "\n".join(
        [f"- {n} × {text}" for text, n in notes.items()] + [f"- {missing} cells were not run"] * (missing > 0)
    )


def bold(text: str, marked: bool) -> str:
    """Return a text in Markdown, in bold if it is marked."""
    return f"**{text}**" if marked else text


def markdown_table(rows: Sequence[Sequence[str]], headers: Sequence[str]) -> str:
    """Return a table in Markdown, with columns of equal width."""
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
"""LaTeX of characters that are special in it or outside of its fonts."""


def latex_tables(captioned: Iterable[tuple[str, Rows]]) -> str:
    """Return tables in LaTeX (booktabs), each under its caption."""
    parts = ["% needs the package booktabs", "% regenerate: python -m bench tables"]
    for caption, (rows, headers) in captioned:
        head, *body = [" & ".join(map(_latex, line)) + r" \\" for line in (headers, *rows)]
        parts += [r"\begin{table}", r"\centering", r"\small", f"\\caption{{{_latex(caption)}}}"]
        parts += [f"\\begin{{tabular}}{{{'l' * len(headers)}}}", r"\toprule", head, r"\midrule", *body]
        parts += [r"\bottomrule", r"\end{tabular}", r"\end{table}"]
    return "\n".join(parts) + "\n"


def _latex(text: str) -> str:
    return re.sub(r"\*\*(.+?)\*\*", r"\\textbf{\1}", text.translate(LATEX))
