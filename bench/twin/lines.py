"""Samples from lines of text: time, a value a sensor, a force a forced DOF; from standard input, a file or a pipe."""

from __future__ import annotations

import os
import re
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TextIO

from bench.contract.online import Sample
from bench.errors import InputError

LOOK_S = 0.02
"""How often a file is looked at that has not grown."""
LONGEST = 65_536
"""Of a line, in letters."""
WITHOUT = ("", "nan", "na", "null", "none")


def numbers(text: str) -> list[float] | None:
    """The numbers of a line, NaN for an empty field; None for what is no line of numbers (a header, a comment)."""
    text = text.strip()
    if not text or text.startswith("#"):
        return None
    fields = [field.strip() for field in re.split(r"[,;\t]", text)] if re.search(r"[,;\t]", text) else text.split()
    try:
        return [float("nan") if field.lower() in WITHOUT else float(field) for field in fields]
    except ValueError:
        return None


@dataclass(frozen=True)
class Form:
    """What stands in a line: time (s), so many values, so many forces."""

    values: int
    forces: int

    def sample(self, text: str) -> Sample | None:
        """The sample of a line; None where it is none."""
        found = numbers(text)
        if found is None or len(found) != 1 + self.values + self.forces:
            return None
        return Sample(found[0], tuple(found[1 : 1 + self.values]), tuple(found[1 + self.values :]))

    @property
    def columns(self) -> str:
        """The columns in words."""
        return ", ".join(["t", *(f"y{i + 1}" for i in range(self.values)), *(f"f{i + 1}" for i in range(self.forces))])


def opened(place: str) -> TextIO:
    """Standard input for ``-``, else a file or a named pipe; raises InputError."""
    if place == "-":
        return sys.stdin
    path = os.path.expanduser(place)
    if not os.path.exists(path):
        raise InputError("from", place, "there is no such file or pipe; - is standard input")
    try:
        return open(path, encoding="utf-8", errors="replace")
    except OSError as error:
        raise InputError("from", place, f"cannot be read: {error.strerror}") from None


def lines(source: TextIO, place: str, follow: bool) -> Iterator[str]:
    """The lines as they come; with ``follow`` a file is waited on for more, and read again from its start if replaced.

    A line without its end is half a line: it is waited for, and left out at the end of a stream.
    """
    half = ""
    try:
        while True:
            text = source.readline(LONGEST)
            if text.endswith("\n"):
                yield half + text
                half = ""
            elif text:
                half += text
                if len(half) >= LONGEST:
                    raise InputError("from", place, f"a line of more than {LONGEST} letters holds no sample")
            elif not follow:
                if half:
                    yield half
                return
            else:
                if _replaced(source, place):
                    source.close()
                    source, half = opened(place), ""
                time.sleep(LOOK_S)
    finally:
        if source is not sys.stdin:
            source.close()


def _replaced(source: TextIO, place: str) -> bool:
    """Whether the file of this name is another one now, or shorter than what has been read."""
    try:
        now, then = os.stat(place), os.fstat(source.fileno())
        return (now.st_ino, now.st_dev) != (then.st_ino, then.st_dev) or now.st_size < source.tell()
    except OSError:
        return False
