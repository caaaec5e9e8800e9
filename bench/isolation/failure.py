"""Failures as text: an exception in one line, and a traceback that does not name the machine's folders.

A method's messages are foreign text: of any length, and with characters that no file or terminal takes.
"""

from __future__ import annotations

import re
import traceback

LONGEST = 300
LONGEST_TRACEBACK = 8000
UNPRINTABLE = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff]")
"""Control characters and lone surrogates: the latter stand for bytes that are no UTF-8, and cannot be encoded."""


def one_line(error: BaseException) -> str:
    """Return an exception's type and message in one line, cut where it is too long for a table."""
    try:
        text = str(error)
    except Exception:  # of a class that somebody else wrote
        text = "(its message cannot be read)"
    return printable(" ".join(f"{type(error).__name__}: {text[: 10 * LONGEST]}".split()), LONGEST)


def printable(text: str, longest: int) -> str:
    """Return the beginning of a text, with an escape for each character that cannot be encoded or printed."""
    return _escaped(text[:longest])[:longest]


def traceback_text() -> str:
    """Return the traceback of the exception that is being handled, without the middle where it is too long."""
    try:
        text = traceback.format_exc()
    except Exception:  # it asks the exception for its message
        text = "the traceback cannot be read"
    half = LONGEST_TRACEBACK // 2
    return _escaped(text if len(text) <= 2 * half else f"{text[:half]}\n[...]\n{text[-half:]}")


def without_places(text: str) -> str:
    """Return a traceback whose files are named by folder and name alone."""
    return re.sub(r'File "[^"]*?((?:[^"/\\]+[/\\]){0,1}[^"/\\]+)"', r'File "\1"', text)


def _escaped(text: str) -> str:
    return UNPRINTABLE.sub(lambda character: character[0].encode("unicode_escape").decode("ascii"), text)
