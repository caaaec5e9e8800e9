"""Typed fields ``name=value``, declared as attributes of a dataclass (a run) or parameters of a function (a verb).

The type of a field determines how its value is parsed and which limits apply; the text in ``Annotated`` is its line of
help. Help, errors and shell completion follow from the declaration::

    def certify(
        data: Annotated[str, "measured record"],
        twins: Annotated[int, Within(ge=0, le=100_000), "simulated repeats"] = 200,
    ) -> int:
        \"\"\"Write the certificate of a measured record.\"\"\"
"""

from __future__ import annotations

import inspect
import os
import typing
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from bench.errors import InputError, did_you_mean
from bench.scenario.declaration import Parsed, value_of

Names = Sequence[str] | Callable[[], Sequence[str]]
EMPTY = inspect.Parameter.empty


class OneOf:
    """Restricts a text, or each text of a tuple, to a list of names; an error suggests the nearest name."""

    def __init__(self, names: Names) -> None:
        self._names = names

    @property
    def names(self) -> Sequence[str]:
        return self._names() if callable(self._names) else self._names

    def check(self, value: Any) -> Any:
        """Return the value if it is one of the names; raises InputError, without the field, otherwise."""
        for name in value if isinstance(value, tuple) else (value,):
            if name not in self.names:
                raise InputError("", name, f"{did_you_mean(name, self.names)}one of {', '.join(self.names)}")
        return value

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], Any]) -> Any:
        """Apply :meth:`check` to the value that pydantic has validated."""
        from pydantic_core import core_schema

        return core_schema.no_info_after_validator_function(self.check, handler(source))


class Others:
    """Fields of a run that a verb also accepts, unparsed; ``system`` includes the fields below it, such as
    ``system.n``."""

    def __init__(self, names: Names) -> None:
        self._names = names

    def take(self, key: str) -> bool:
        """Return whether a field is one of these or is below one of them."""
        names = self._names() if callable(self._names) else self._names
        return key in names or key.partition(".")[0] in names


class Bare:
    """Marks a field whose value may be given without its name: ``score predictions.csv``."""


@dataclass(frozen=True)
class Field:
    """A field of the command line: a parameter of a verb, or an attribute of a run."""

    parameter: str
    kind: Any
    default: Any
    text: str

    @property
    def name(self) -> str:
        """The name on the command line: ``from`` for the parameter ``from_``."""
        return self.parameter.rstrip("_")

    @property
    def required(self) -> bool:
        return self.default is EMPTY and self.others is None

    @cached_property
    def others(self) -> Others | None:
        """The fields of a run that this parameter collects; None for an ordinary field."""
        return next((part for part in typing.get_args(self.kind) if isinstance(part, Others)), None)

    @property
    def bare(self) -> bool:
        """True if the value may be given without the name."""
        return any(isinstance(part, Bare) for part in typing.get_args(self.kind))

    @cached_property
    def types(self) -> set[Any]:
        """The types of the value, without their limits; empty if the text has a parser of its own."""
        parsed = any(isinstance(part, Parsed) for part in typing.get_args(self.kind))
        return set() if parsed else set(_leaves(self.kind))

    @property
    def choices(self) -> Sequence[str]:
        """The names among which the value is chosen; empty if it is not a choice."""
        named = next((part.names for part in typing.get_args(self.kind) if isinstance(part, OneOf)), ())
        if bool in self.types:
            return ("true", "false")
        return named or next((typing.get_args(t) for t in self.types if typing.get_origin(t) is Literal), ())

    def read(self, text: str) -> Any:
        """Parse the text of a value; raises InputError."""
        if not text:
            raise InputError(self.name, text, "give a value, or leave the field out")
        value: Any = os.path.expanduser(text) if Path in self.types else text
        if tuple in self.types:
            value = tuple(part.strip() for part in text.split(","))
            if len(set(value)) < len(value) or "" in value:
                raise InputError(self.name, text, "write names separated by commas, each once")
        return value_of(self.kind, value, self.name)

    def line(self, width: int) -> str:
        """Return the line of help; ``width`` is the width of the column of names."""
        name = "..." if self.others else self.name
        values = ", ".join(self.choices) if bool not in self.types and len(self.choices) <= MOST_LISTED else ""
        default = written(self.default) if isinstance(self.default, str | int | float | tuple | Path) else ""
        shown = f"[{default}] " if default else ""
        return f"  {name:<{width}}  {shown}{'; '.join(part for part in (self.text, values) if part)}"


MOST_LISTED = 12
"""A line of help lists the choices of a field up to this number."""


def fields_of(declared: Callable[..., Any]) -> dict[str, Field]:
    """Return the fields of a function or dataclass by name."""
    kinds = typing.get_type_hints(declared, include_extras=True)
    fields = {}
    for name, parameter in inspect.signature(declared).parameters.items():
        text = next(part for part in typing.get_args(kinds[name]) if isinstance(part, str))
        fields[name.rstrip("_")] = Field(name, kinds[name], parameter.default, " ".join(text.split()))
    return fields


def written(value: Any) -> str:
    """Format a value as the text of a field; None is empty."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple | list):
        return ",".join(map(written, value))
    if isinstance(value, float):
        return f"{value:g}"
    return "" if value is None else str(value)


def _leaves(kind: Any) -> typing.Iterator[Any]:
    origin = typing.get_origin(kind)
    if origin is typing.Annotated:
        yield from _leaves(typing.get_args(kind)[0])
    elif origin in (typing.Union, type(int | None)):
        for part in typing.get_args(kind):
            yield from _leaves(part)
    else:
        yield kind if origin in (None, Literal) else origin
