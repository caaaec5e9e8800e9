"""The standard streams of a command: closed, full, or unable to hold a letter."""

from __future__ import annotations

import io
import os
import sys
from contextlib import suppress
from typing import TextIO

from bench.errors import InputError


def prepare_streams() -> None:
    """Make the streams safe to use.

    A stream that is closed is opened on nothing, or the next file to be opened would take its place. Letters that a
    stream cannot hold become ``?``. What cannot be written to the error stream is lost, and ends nothing: it tells how
    far a run is.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.dup2(os.open(os.devnull, os.O_RDWR), number)
    if sys.stderr is None or sys.stderr is sys.__stderr__:
        encoding = getattr(sys.stderr, "encoding", "utf-8")
        sys.stderr = _lossy(2, encoding)
    if sys.stdout is not None and sys.stdout is sys.__stdout__:
        sys.stdout = _named(sys.__stdout__)
    if sys.stdin is None:
        sys.stdin = open(os.devnull, encoding="utf-8")  # noqa: SIM115 - as long as the process
    for stream in (sys.stdout, sys.stderr):
        if getattr(stream, "errors", None) == "strict" and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")


def check_output() -> None:
    """Raise InputError where the output is closed: nobody would see what is computed."""
    if sys.stdout is None:
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 - as long as the process
        raise InputError("output", "closed", f"an output that can be written; > {os.devnull} where none is wanted")


def drop_output() -> None:
    """Send what is printed from now on to nothing, so that Python's end does not complain once more."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


OUTPUT = "standard output"
"""What an error calls the output, as it calls a file by its path."""


class _Named(io.FileIO):
    """The output, whose errors say that they are of it."""

    def write(self, content: object) -> int:
        """Write, and name what cannot be written."""
        try:
            return super().write(content)  # type: ignore[arg-type]
        except OSError as error:
            raise OSError(error.errno, error.strerror, OUTPUT) from None


def _named(stream: TextIO) -> TextIO:
    """The output by another object: what is printed reaches it as before."""
    stream.flush()
    raw = _Named(stream.fileno(), "w", closefd=False)
    at_once = getattr(stream, "write_through", False)
    return io.TextIOWrapper(
        io.BufferedWriter(raw), stream.encoding, "replace", line_buffering=stream.isatty(), write_through=at_once
    )


class _Lossy(io.FileIO):
    """A file whose writes never fail."""

    def write(self, content: object) -> int:
        """Write what can be written."""
        with suppress(OSError):
            return super().write(content)  # type: ignore[arg-type]
        return len(content)  # type: ignore[arg-type]


def _lossy(number: int, encoding: str) -> TextIO:
    raw = _Lossy(number, "w", closefd=False)
    return io.TextIOWrapper(raw, encoding, "backslashreplace", line_buffering=True, write_through=True)  # type: ignore[arg-type]
