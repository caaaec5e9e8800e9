"""Checks of the numbers of a scenario and the options of a system, before any objects are made."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from bench.errors import InputError, did_you_mean
from bench.scenario.declaration import declared_types
from bench.systems import load_system

LEAST, MOST = 1e-15, 1e15
"""Limits of the absolute value of every number of a scenario other than 0 (SI units)."""
COUNTS = {"samples": 1_000_000, "tones": 10_000, "n": 1000}
"""Upper limits of counts, by field: samples of a force, sine waves in it, masses of a chain."""
FLAGS = ("prior.wrong", "system.options.")
"""Fields of a scenario that may be true or false."""


def check_numbers(content: Mapping[str, Any]) -> None:
    """Raise InputError for a boolean in place of a number, and for a number outside the limits."""
    for path, value in _leaves(content):
        if isinstance(value, bool):
            if not path.startswith(FLAGS):
                raise InputError(path, value, "a number or a name, not true or false")
        elif isinstance(value, int | float) and abs(value) < float("inf"):  # the field's type rejects infinity
            most = COUNTS.get(path.rpartition(".")[2], MOST)
            if abs(value) > most:
                raise InputError(path, value, f"at most {most:g}")
            if 0 < abs(value) < LEAST:
                raise InputError(path, value, f"at least {LEAST:g}")


def _leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the path and value of every leaf; the items of a list have the path of the list."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _leaves(item, f"{path}.{key}" if path else str(key))
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _leaves(item, path)
    else:
        yield path, value


def check_system(kind: Any, options: Any) -> None:
    """Raise InputError for an unknown option of a system, and for a count that is not an integer."""
    if not isinstance(kind, str) or not isinstance(options, Mapping) or not is_dataclass(system := load_system(kind)):
        return  # the types of the scenario's fields reject the first two cases
    types, names = declared_types(system), [f.name for f in fields(system)]
    for name, value in options.items():
        if name not in names:
            known = f"fields: {', '.join(names)}" if names else "this system has no options"
            raise InputError(f"system.options.{name}", value, f"not a field; {did_you_mean(name, names)}{known}")
        if types[name] is int and type(value) is not int:
            raise InputError(f"system.options.{name}", value, "must be a whole number")
