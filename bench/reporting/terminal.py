"""What a terminal shows: tables and sentences that are no wider than it, whatever script their names are in.

Widths are those on a screen, where a letter of some scripts takes two places and an accent none.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
from collections.abc import Collection, Sequence

from wcwidth import width, wrap

WIDTH, NARROWEST = 80, 40
"""Places of sentences at most, for longer lines are hard to read; and of any line at least."""
LEAST_COLUMN = 6
"""Places of a column of words at least."""
GAP = 2


def columns() -> int:
    """Return the places in a line: those of the terminal, or ``COLUMNS``, 40 at least; 80 where there is none."""
    return max(NARROWEST, shutil.get_terminal_size((WIDTH, 24)).columns)


def wrapped(text: str, hanging: str = "  ", start: str = "") -> str:
    """Return a sentence on as many lines as it needs. Words stay whole unless one is longer than a line."""
    places = min(WIDTH, columns())
    return "\n".join(wrap(text, places, initial_indent=start, subsequent_indent=hanging, break_on_hyphens=False))


def help_page(text: str) -> str:
    """Lay out a page of usage: sentences as paragraphs; a field goes on below where its explanation begins."""
    paragraphs = []
    for paragraph in text.split("\n\n"):
        lines = paragraph.splitlines() if "  " in paragraph else [paragraph.replace("\n", " ")]
        fields = [(line, re.match(r" *\S+(?: \S+)* {2,}", line)) for line in lines]
        explained = [min(field.end(), columns() // 2) if field else 2 * (line[:1] == " ") for line, field in fields]
        paragraphs.append("\n".join(wrapped(line, " " * n) for line, n in zip(lines, explained, strict=True)))
    return "\n\n".join(paragraphs)


def coloured(text: str, number: int) -> str:
    """Return a text in a colour, by its number in ECMA-48, where :func:`colour_shown`."""
    return f"\x1b[{number}m{text}\x1b[0m" if colour_shown() else text


def colour_shown() -> bool:
    """Return whether standard output is a terminal that has colour, and NO_COLOR (no-color.org) is not set."""
    return sys.stdout.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


def table(rows: Sequence[Sequence[str]], headers: Sequence[str], words: Collection[int] = (0,)) -> str:
    """Return a table no wider than the terminal: ``words`` are the columns of words, the others hold numbers.

    Words stand on the left, and on several lines where the table would be too wide, as headings do; numbers stand on
    the right and are never broken. Where so many numbers do not fit side by side, each row is a list of its own.
    """
    numbers = [max((width(row[i]) for row in rows), default=0) for i in range(len(headers))]
    if _fill([max(width(heading), numbers[i]) for i, heading in enumerate(headers)]) > columns():
        headers = [heading if i in words else _narrowed(heading, numbers[i]) for i, heading in enumerate(headers)]
        narrow = [max(numbers[i], *map(width, heading.split("\n"))) for i, heading in enumerate(headers)]
        if _fill([LEAST_COLUMN if i in words else places for i, places in enumerate(narrow)]) > columns():
            return "\n".join(_listed(row, [heading.replace("\n", " ") for heading in headers]) for row in rows)
    return _laid_out(rows, headers, words)


def _fill(widths: Sequence[int]) -> int:
    """Return the places that columns of these widths fill side by side."""
    return sum(widths) + GAP * (len(widths) - 1)


def _narrowed(heading: str, least: int) -> str:
    """Break a heading between words, at least so many places wide."""
    return "\n".join(wrap(heading, max([least, 1, *map(width, heading.split())])))


def _listed(row: Sequence[str], headers: Sequence[str]) -> str:
    """Return a row below its first cell, each of the others on a line behind its heading."""
    lines = [(f"  {heading}", text) for heading, text in zip(headers[1:], row[1:], strict=True) if text]
    return "\n".join([wrapped(f"{headers[0]} {row[0]}".strip()), *([_laid_out(lines, (), (0, 1))] if lines else [])])


def _laid_out(rows: Sequence[Sequence[str]], headers: Sequence[str], words: Collection[int]) -> str:
    """Return rows in columns, below their headings if there are any."""
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
    # without a height, rich takes a dumb terminal for 80 places wide
    console = Console(width=columns(), height=1, color_system=None, force_jupyter=False)
    with console.capture() as capture:
        console.print(shown)
    return "\n".join(line.rstrip() for line in capture.get().splitlines())
