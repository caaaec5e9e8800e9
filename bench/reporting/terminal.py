"""Tables and sentences for the terminal, no wider than it.

Widths are those on a screen, where characters of some scripts take two columns and combining accents none.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
from collections.abc import Collection, Sequence

from wcwidth import width, wrap

WIDTH, NARROWEST = 80, 40
"""Largest width of sentences, for legibility, and smallest width of any line (columns)."""
NARROWEST_WORDS = 6
"""Smallest width of a column of words."""
GAP = 2
"""Distance between columns of a table."""


def columns() -> int:
    """Return the width of the terminal, or of ``COLUMNS``, at least 40; 80 without a terminal."""
    return max(NARROWEST, shutil.get_terminal_size((WIDTH, 24)).columns)


def wrapped(text: str, hanging: str = "  ", start: str = "") -> str:
    """Wrap a sentence. Words are broken only if they are longer than a line."""
    return "\n".join(
        wrap(text, min(WIDTH, columns()), initial_indent=start, subsequent_indent=hanging, break_on_hyphens=False)
    )


def help_page(text: str) -> str:
    """Lay out a page of help: sentences as paragraphs, explanations of fields with a hanging indent."""
    paragraphs = []
    for paragraph in text.split("\n\n"):
        lines = paragraph.splitlines() if "  " in paragraph else [paragraph.replace("\n", " ")]
        fields = [(line, re.match(r" *\S+(?: \S+)* {2,}", line)) for line in lines]
        explained = [min(field.end(), columns() // 2) if field else 2 * (line[:1] == " ") for line, field in fields]
        paragraphs.append("\n".join(wrapped(line, " " * n) for line, n in zip(lines, explained, strict=True)))
    return "\n\n".join(paragraphs)


def coloured(text: str, number: int) -> str:
    """Return a text in a colour (ECMA-48 number), if :func:`colour_shown`."""
    return f"\x1b[{number}m{text}\x1b[0m" if colour_shown() else text


def colour_shown() -> bool:
    """Return whether standard output is a terminal with colour and NO_COLOR (no-color.org) is not set."""
    return sys.stdout.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


def table(rows: Sequence[Sequence[str]], headers: Sequence[str], words: Collection[int] = (0,)) -> str:
    """Return a table no wider than the terminal.

    Args:
        rows: The cells as text, row by row.
        headers: The headings.
        words: Indices of the columns of words, which are aligned left and wrapped if the table is too wide. All other
            columns hold numbers, which are aligned right and never broken.

    Returns:
        The table; where the numbers of a row do not fit into a line, each row is a list.
    """
    numbers = [max((width(row[i]) for row in rows), default=0) for i in range(len(headers))]
    if _total_width([max(width(heading), numbers[i]) for i, heading in enumerate(headers)]) > columns():
        headers = [heading if i in words else _narrowed(heading, numbers[i]) for i, heading in enumerate(headers)]
        narrow = [max(numbers[i], *map(width, heading.split("\n"))) for i, heading in enumerate(headers)]
        if _total_width([NARROWEST_WORDS if i in words else n for i, n in enumerate(narrow)]) > columns():
            return "\n".join(_listed(row, [heading.replace("\n", " ") for heading in headers]) for row in rows)
    return _laid_out(rows, headers, words)


def _total_width(widths: Sequence[int]) -> int:
    """Return the width of columns with the gaps between them."""
    return sum(widths) + GAP * (len(widths) - 1)


def _narrowed(heading: str, least: int) -> str:
    """Break a heading between words; its width is at least ``least`` and that of its longest word."""
    return "\n".join(wrap(heading, max([least, 1, *map(width, heading.split())])))


def _listed(row: Sequence[str], headers: Sequence[str]) -> str:
    """Return a row as a list: the first cell, then one line with heading and text per further cell."""
    lines = [(f"  {heading}", text) for heading, text in zip(headers[1:], row[1:], strict=True) if text]
    return "\n".join([wrapped(f"{headers[0]} {row[0]}".strip()), *([_laid_out(lines, (), (0, 1))] if lines else [])])


def _laid_out(rows: Sequence[Sequence[str]], headers: Sequence[str], words: Collection[int]) -> str:
    """Return rows in columns below their headings, if there are any."""
    from rich.console import Console
    from rich.rule import Rule
    from rich.table import Table
    from rich.text import Text

    shown = Table(box=None, padding=(0, GAP, 0, 0), pad_edge=False, show_header=bool(headers))
    for i, heading in enumerate(headers or rows[0]):
        side = "left" if i in words else "right"
        shown.add_column(Text(heading), justify=side, no_wrap=i not in words, overflow="fold")  # type: ignore[arg-type]
    if headers:
        shown.add_row(*[Rule(characters="-", style="")] * len(headers))
    for row in rows:
        shown.add_row(*map(Text, row))
    # without a height, rich assumes that a dumb terminal has 80 columns
    console = Console(width=columns(), height=1, color_system=None, force_jupyter=False)
    with console.capture() as capture:
        console.print(shown)
    return "\n".join(line.rstrip() for line in capture.get().splitlines())
