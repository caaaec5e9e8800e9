"""What all commands share: arguments as fields, help, one line for bad input, and the exit status."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from bench.errors import InputError
from bench.isolation.ending import Ended, ended_by_signals


def command(
    name: str,
    page: str,
    argv: Sequence[str] | None,
    body: Callable[[list[str]], int],
    interrupted: str = "interrupted",
) -> int:
    """A command by itself: its arguments, ``page`` for who asks for help, else its body as :func:`guarded` runs it."""
    arguments = list(sys.argv[1:] if argv is None else argv)

    def run() -> int:
        if {"-h", "--help"} & set(arguments):
            print(page)
            return 0
        return body(arguments)

    return guarded(name, run, interrupted)


def guarded(name: str, body: Callable[[], int], interrupted: str = "interrupted") -> int:
    """Run a command; its exit status, which is 2 for bad input, 130 for Ctrl-C, 141 where its reader has gone.

    SIGTERM and SIGHUP give 143 and 129. Each of these is one line on the error stream, a reader that has gone none;
    letters that the output cannot hold become ``?``.
    """
    for stream in (sys.stdout, sys.stderr):
        if getattr(stream, "errors", None) == "strict" and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    try:
        with ended_by_signals():
            status = body()
        sys.stdout.flush()  # here, where a reader that has gone is no traceback
        return status
    except InputError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"\n{name}: {interrupted}", file=sys.stderr)
        return 130
    except Ended as ended:
        with contextlib.suppress(OSError):  # the terminal may be gone
            print(f"{name}: {interrupted}", file=sys.stderr)
        return ended.status
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141


def read_fields(arguments: Sequence[str], defaults: Mapping[str, str], wanted: str = "") -> dict[str, str]:
    """Values given as ``field=value``, over the defaults; raises InputError, which says what is ``wanted`` instead."""
    fields = dict(defaults)
    for argument in arguments:
        key, _, value = argument.partition("=")
        if key not in fields or not value:
            raise InputError("argument", argument, wanted or f"write one of {', '.join(f'{k}=' for k in defaults)}")
        fields[key] = value
    return fields


def whole(field: str, text: str, least: int = 1, most: int | None = None) -> int:
    """A whole number within limits; raises InputError."""
    if not text.isdecimal() or int(text) < least or (most is not None and int(text) > most):
        within = f"of at least {least}" if most is None else f"from {least} to {most}"
        raise InputError(field, text, f"a whole number {within}")
    return int(text)


def read_folders(arguments: Sequence[str], defaults: Mapping[str, str]) -> dict[str, Path]:
    """Folders given as ``field=path``, over the defaults; raises InputError for anything else."""
    wanted = f"write {' or '.join(f'{field}=<folder>' for field in defaults)}"
    return {key: Path(value) for key, value in read_fields(arguments, defaults, wanted).items()}
