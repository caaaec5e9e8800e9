"""What a terminal shows: tables and sentences that are no wider than it, whatever script their names are in.

Widths are those on a screen, where a letter of some scripts takes two places and an accent none.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
from collections.abc import Collection, Sequence

import wcwidth

WIDTH, NARROWEST = 80, 40
"""Places of sentences at most, for longer lines are hard to read; and of any line at least."""
LEAST_COLUMN = 6
"""Places of a column of words at least."""
GAP = 2
COLOURS = {"green": 32, "yellow": 33}
"""Numbers of ECMA-48's select graphic rendition."""


def columns() -> int:
    """Places in a line: those of the terminal, 40 at least; 80 where there is none. ``COLUMNS`` overrides."""
    return max(NARROWEST, shutil.get_terminal_size((WIDTH, 24)).columns)


def width(text: str) -> int:
    """Places that one line of text takes on a screen."""
    return len(text) if text.isascii() and text.isprintable() else int(wcwidth.width(text))


def wrapped(text: str, hanging: str = "  ", start: str = "") -> str:
    """A sentence on as many lines as it needs. Words stay whole unless one is longer than a line."""
    places = min(WIDTH, columns())
    return "\n".join(
        wcwidth.wrap(text, places, initial_indent=start, subsequent_indent=hanging, break_on_hyphens=False) or [""]
    )


def help_page(text: str) -> str:
    """A page of usage: its sentences as paragraphs; a field goes on below where its explanation begins."""
    parts: list[str] = []
    for line in text.splitlines():
        if parts and _is_prose(line) and _is_prose(parts[-1]):
            parts[-1] += f" {line}"
        else:
            parts.append(line)
    return "\n".join(wrapped(part, "" if _is_prose(part) else " " * _explained(part)) for part in parts)


def _is_prose(line: str) -> bool:
    """Whether a line of a page is a part of a paragraph, not of a list of fields, and no title of one."""
    return bool(line) and not line.startswith((" ", "usage:")) and "  " not in line and not line.endswith(":")


def _explained(line: str) -> int:
    """Where the explanation of a field begins."""
    found = re.match(r" *\S+(?: \S+)* {2,}", line)
    return min(found.end() if found else 2, columns() // 2)


def coloured(text: str, colour: str) -> str:
    """A text in a colour where :func:`colour_shown`."""
    return f"\x1b[{COLOURS[colour]}m{text}\x1b[0m" if colour_shown() else text


def colour_shown() -> bool:
    """Whether standard output is a terminal that has colour, and NO_COLOR (no-color.org) is not set."""
    return sys.stdout.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


def clipped(text: str) -> str:
    """The start of a text, as much as stands on one line."""
    most = columns() - 1  # a full line would make some terminals begin another
    return text if width(text) <= most else f"{wcwidth.clip(text, 0, most - 1).rstrip()}…"


def table(rows: Sequence[Sequence[str]], headers: Sequence[str], words: Collection[int] = (0,)) -> str:
    """Return a table no wider than the terminal: ``words`` are the columns of words, the others hold numbers.

    Words stand on the left, and on several lines where the table would be too wide, as headings do; numbers stand on
    the right and are never broken. Where so many numbers do not fit side by side, each row is a list of its own.
    """
    from rich.console import Console
    from rich.rule import Rule
    from rich.table import Table
    from rich.text import Text

    numbers = [max((width(row[i]) for row in rows), default=0) for i in range(len(headers))]
    if _fill([max(width(heading), numbers[i]) for i, heading in enumerate(headers)]) > columns():
        headers = [heading if i in words else _narrowed(heading, numbers[i]) for i, heading in enumerate(headers)]
        narrow = [max(numbers[i], *map(width, heading.split("\n"))) for i, heading in enumerate(headers)]
        if _fill([LEAST_COLUMN if i in words else places for i, places in enumerate(narrow)]) > columns():
            return "\n".join(_listed(row, headers) for row in rows)
    shown = Table(box=None, padding=(0, GAP, 0, 0), pad_edge=False)
    for i, heading in enumerate(headers):
        shown.add_column(
            Text(heading), justify="left" if i in words else "right", no_wrap=i not in words, overflow="fold"
        )
    shown.add_row(*[Rule(characters="-", style="")] * len(headers))
    for row in rows:
        shown.add_row(*map(Text, row))
    # without a height, rich takes a dumb terminal for 80 places wide
    console = Console(width=columns(), height=1, color_system=None, force_jupyter=False)
    with console.capture() as capture:
        console.print(shown)
    return "\n".join(line.rstrip() for line in capture.get().splitlines())


def _fill(widths: Sequence[int]) -> int:
    """Return the places that columns of these widths fill side by side."""
    return sum(widths) + GAP * (len(widths) - 1)


def _narrowed(heading: str, least: int) -> str:
    """Break a heading between words, at least so many places wide."""
    return "\n".join(wcwidth.wrap(heading, max([least, *map(width, heading.split())]))) if heading else heading


def _listed(row: Sequence[str], headers: Sequence[str]) -> str:
    """A row below its first cell, each of the others on a line behind its heading."""
    places = min(max(map(width, headers[1:])), columns() // 2)
    lines = [wrapped(f"{headers[0]} {row[0]}".strip())]
    for heading, text in zip(headers[1:], row[1:], strict=True):
        filled = heading + " " * (places - width(heading))
        lines += [wrapped(f"  {filled}  {text}", " " * (places + 4))] if text else []
    return "\n".join(lines)
