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
"""Time until a file that has not grown is looked at again (s)."""
LONGEST = 65_536
"""Characters of a line."""
MISSING = ("", "nan", "na", "null", "none")


@dataclass(frozen=True)
class Form:
    """The columns of a line: time (s), so many values, so many forces."""

    values: int
    forces: int

    @property
    def columns(self) -> str:
        """The columns in words."""
        return ", ".join(["t", *(f"y{i + 1}" for i in range(self.values)), *(f"f{i + 1}" for i in range(self.forces))])

    def sample(self, text: str) -> Sample | None:
        """Return the sample of a line, NaN for an empty field; None for another line (a header, a comment)."""
        fields = re.split(r"\s*[,;\t]\s*", text.strip(" \r\n")) if re.search(r"[,;\t]", text) else text.split()
        try:
            time_s, *numbers = [float("nan" if field.lower() in MISSING else field) for field in fields]
        except ValueError:
            return None
        if len(numbers) != self.values + self.forces:
            return None
        return Sample(time_s, tuple(numbers[: self.values]), tuple(numbers[self.values :]))


def opened(place: str) -> TextIO:
    """Return standard input for ``-``, else a file or a named pipe; raises InputError."""
    if place == "-":
        return sys.stdin
    try:
        return open(os.path.expanduser(place), encoding="utf-8", errors="replace")
    except FileNotFoundError:
        raise InputError("from", place, "there is no such file or pipe; - is standard input") from None
    except OSError as error:
        raise InputError("from", place, f"cannot be read: {error.strerror}") from None


def lines(source: TextIO, place: str, follow: bool) -> Iterator[str]:
    """Return the lines as they come; with ``follow`` a file is waited on for more.

    A line without its end is half a line: the rest is waited for, or it is the last of the stream.
    """
    text = ""
    while True:
        text += source.readline(LONGEST)
        if text.endswith("\n"):
            yield text
            text = ""
        elif len(text) >= LONGEST:
            raise InputError("from", place, f"a line of more than {LONGEST} letters holds no sample")
        elif follow:
            time.sleep(LOOK_S)
        else:
            if text:
                yield text
            return
