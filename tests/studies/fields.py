"""The fields of a study's command line, ``field=value``, and how the study is run."""

from __future__ import annotations

import math
import os
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from bench.commands.guard import guarded
from bench.errors import InputError, did_you_mean

LARGEST = 10**9
"""The largest whole number that a command takes where none of its own says otherwise."""
DIGITS = 19
"""Of a whole number, at most: no limit has more."""


def read_fields(arguments: Sequence[str], defaults: Mapping[str, str], wanted: str = "") -> dict[str, str]:
    """Values given as ``field=value``, over the defaults.

    Raises InputError for what is no such field, has no value or is given twice; ``wanted`` says what is right instead.
    """
    given: dict[str, str] = {}
    for argument in arguments:
        key, equals, value = argument.partition("=")
        if key not in defaults or not equals:
            fields = f"write one of {', '.join(f'{name}=' for name in defaults)}"
            raise InputError("argument", argument, wanted or f"{did_you_mean(key, list(defaults))}{fields}")
        if not value:
            raise InputError(key, value, "give a value, or leave the field out")
        if key in given:
            raise InputError(key, value, "given twice; give it once")
        given[key] = value
    return {**defaults, **given}


def whole(field: str, text: str, least: int = 1, most: int = LARGEST) -> int:
    """A whole number within limits; raises InputError."""
    if not re.fullmatch(rf"[0-9]{{1,{DIGITS}}}", text) or not least <= int(text) <= most:
        raise InputError(field, text, f"a whole number from {least} to {most}")
    return int(text)


def number(
    field: str,
    text: str,
    above: float = -math.inf,
    most: float = math.inf,
    wanted: str = "a number",
    shown: str | None = None,
) -> float:
    """A finite number above a limit and up to another.

    Raises InputError, which says what is ``wanted``, and shows the value as ``shown`` where the number is a part of it.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and above < value <= most):
        remedy = wanted if math.isinf(most) else f"{wanted}, at most {most:g}"
        raise InputError(field, text if shown is None else shown, remedy)
    return value


def positive(field: str, text: str, most: float = math.inf) -> float:
    """A positive finite number; raises InputError."""
    return number(field, text, 0.0, most, "a positive number")


def flag(field: str, text: str) -> bool:
    """Whether a field says ``true``; raises InputError for what is neither that nor ``false``."""
    if text not in ("true", "false"):
        raise InputError(field, text, "true or false")
    return text == "true"


def one_of(field: str, text: str, names: Sequence[str]) -> str:
    """One of some names; raises InputError, which guesses what was meant."""
    if text not in names:
        of = " or ".join(names) if len(names) < 3 else f"one of {', '.join(names)}"
        raise InputError(field, text, f"{did_you_mean(text, names)}{of}")
    return text


def listed(field: str, text: str) -> list[str]:
    """Names with commas between them, at least one; raises InputError."""
    names = [part.strip() for part in text.split(",")]
    if not all(names):
        raise InputError(field, text, "one name, or several with a comma between two")
    return names


def path_of(text: str) -> Path:
    """A path as it was given, ``~`` standing for the home folder."""
    return Path(os.path.expanduser(text))


def folder_of(field: str, text: str) -> Path:
    """A folder that is there; raises InputError."""
    path = path_of(text)
    if not os.path.isdir(path):
        raise InputError(field, text, "there is no such folder; name one that is there")
    return path


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
            from bench.reporting.terminal import help_page

            print(help_page(page))
            return 0
        return body(arguments)

    return guarded(name, run, interrupted)
