"""Exceptions as text: in one line, and as a traceback without the folders of the machine.

The messages of a method may have any length and contain characters that cannot be printed or encoded.
"""

from __future__ import annotations

import re
import traceback

LONGEST = 300
LONGEST_TRACEBACK = 8000
UNPRINTABLE = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff]")
"""Control characters, and lone surrogates, which stand for bytes that are not UTF-8 and cannot be encoded."""


def one_line(error: BaseException) -> str:
    """Return the type and message of an exception in one line, truncated for tables."""
    try:
        text = str(error)
    except Exception:  # a foreign class may have a faulty __str__
        text = "(its message cannot be read)"
    return printable(" ".join(f"{type(error).__name__}: {text[: 10 * LONGEST]}".split()), LONGEST)


def printable(text: str, longest: int) -> str:
    """Truncate a text, and escape the characters that cannot be encoded or printed."""
    return _escaped(text[:longest])[:longest]


def traceback_text() -> str:
    """Return the traceback of the current exception; the middle of a long one is omitted."""
    try:
        text = traceback.format_exc()
    except Exception:  # a foreign exception may have a faulty __str__
        text = "the traceback cannot be read"
    half = LONGEST_TRACEBACK // 2
    return _escaped(text if len(text) <= 2 * half else f"{text[:half]}\n[...]\n{text[-half:]}")


def without_folders(text: str) -> str:
    """Shorten the paths in a traceback to the file name and its folder."""
    return re.sub(r'File "[^"]*?((?:[^"/\\]+[/\\]){0,1}[^"/\\]+)"', r'File "\1"', text)


def _escaped(text: str) -> str:
    return UNPRINTABLE.sub(lambda character: character[0].encode("unicode_escape").decode("ascii"), text)
