"""How a failure is told: an exception in one line, and a traceback that says nothing of the machine it was on."""

from __future__ import annotations

import re

LONGEST = 300


def one_line(error: BaseException) -> str:
    """An exception's type and message in one line, cut where it is too long for a table."""
    return " ".join(f"{type(error).__name__}: {error}".split())[:LONGEST]


def without_places(text: str) -> str:
    """A traceback whose files are named by folder and name alone: where a machine keeps them tells nobody anything."""
    return re.sub(r'File "[^"]*?((?:[^"/\\]+[/\\]){0,1}[^"/\\]+)"', r'File "\1"', text)
