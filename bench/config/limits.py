"""What no number of a scenario may be: true or false, or so large or small that its square is no number any more."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from bench.errors import InputError
from bench.scenario.declaration import declared_types
from bench.scenario.scenario import PriorSpec
from bench.systems import load_system

LEAST, MOST = 1e-15, 1e15
"""Of every number of a scenario but 0, whatever it measures (SI units): nothing that vibrates is outside."""
COUNTS = {"samples": 1_000_000, "tones": 10_000, "n": 1000}
"""The most of what a number counts, by its name: samples of a force, sine waves in it, masses of a chain."""
FLAGS = {f"prior.{f.name}" for f in fields(PriorSpec) if declared_types(PriorSpec)[f.name] is bool}
FREE = ("system.options.",)
"""Where a system says itself what is true or false."""


def check_numbers(content: Mapping[str, Any]) -> None:
    """Raise InputError for a number of a scenario's groups that is none, or beyond all limits.

    What a field of a certain name may be is said where it is declared; this is what all have in common, and keeps what
    cannot be computed from being tried.
    """
    for path, value in _leaves(content):
        if isinstance(value, bool):
            if path not in FLAGS and not path.startswith(FREE):
                raise InputError(path, value, "a number or a name, not true or false")
        elif isinstance(value, int | float) and value == value:
            _check_size(path, value)


def _check_size(path: str, value: float) -> None:
    most = COUNTS.get(path.rpartition(".")[2], MOST)
    if abs(value) > most and abs(value) != float("inf"):  # of what is infinite its declaration speaks
        raise InputError(path, value, f"at most {most:g}")
    if 0 < abs(value) < LEAST:
        raise InputError(path, value, f"at least {LEAST:g}")


def _leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Every value that holds no others, with its path; the items of a list have the path of the list."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _leaves(item, f"{path}.{key}" if path else str(key))
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _leaves(item, path)
    else:
        yield path, value


def check_options(system: Mapping[str, Any]) -> None:
    """Raise InputError for an option of a system that counts something and is no whole number."""
    options, kind = system.get("options"), system.get("kind")
    if not isinstance(kind, str) or not isinstance(options, Mapping):
        return  # what is wrong with them is said where they are declared
    of = load_system(kind)
    types: Mapping[str, Any] = declared_types(of) if is_dataclass(of) else {}
    for name, value in options.items():
        if types.get(name) is int and type(value) is not int:
            raise InputError(f"system.options.{name}", value, "a whole number")
