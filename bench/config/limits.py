"""Limits that all numbers of a scenario share, and the options of a system, checked before anything is made."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from bench.errors import InputError, did_you_mean
from bench.scenario.declaration import declared_types
from bench.systems import load_system

LEAST, MOST = 1e-15, 1e15
"""Of every number of a scenario but 0, whatever it measures (SI units): nothing that vibrates is outside."""
COUNTS = {"samples": 1_000_000, "tones": 10_000, "n": 1000}
"""The most of what a number counts, by its name: samples of a force, sine waves in it, masses of a chain."""
FLAGS = ("prior.wrong", "system.options.")
"""Where a scenario may hold true or false."""


def check_numbers(content: Mapping[str, Any]) -> None:
    """Raise InputError for a number of a scenario's groups that is none, or beyond all limits."""
    for path, value in _leaves(content):
        if isinstance(value, bool):
            if not path.startswith(FLAGS):
                raise InputError(path, value, "a number or a name, not true or false")
        elif isinstance(value, int | float) and abs(value) < float("inf"):  # its type refuses what is not finite
            most = COUNTS.get(path.rpartition(".")[2], MOST)
            if abs(value) > most:
                raise InputError(path, value, f"at most {most:g}")
            if 0 < abs(value) < LEAST:
                raise InputError(path, value, f"at least {LEAST:g}")


def _leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Give every value that holds no others, with its path; the items of a list have the path of the list."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _leaves(item, f"{path}.{key}" if path else str(key))
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _leaves(item, path)
    else:
        yield path, value


def check_system(kind: Any, options: Any) -> None:
    """Raise InputError for an option that a system does not have, and for a count that is not whole."""
    if not isinstance(kind, str) or not isinstance(options, Mapping) or not is_dataclass(system := load_system(kind)):
        return  # the types of a scenario's fields refuse the first two
    types, names = declared_types(system), [f.name for f in fields(system)]
    for name, value in options.items():
        if name not in names:
            known = f"there are {', '.join(names)}" if names else "there is none"
            raise InputError(f"system.options.{name}", value, f"no such field; {did_you_mean(name, names)}{known}")
        if types[name] is int and type(value) is not int:
            raise InputError(f"system.options.{name}", value, "a whole number")
