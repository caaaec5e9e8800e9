"""The declaration of a dataclass's fields, and what it is used for: limits on a command line, and the way to JSON.

A field is declared once, in the dataclass that holds it. Its type says how it is written and read, and its default when
it is left out of an identity.
"""

from __future__ import annotations

import types
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin, get_type_hints

from annotated_types import Interval as Within

from bench.errors import InputError

Validated = TypeVar("Validated")
STRICT: Any = {"extra": "forbid", "allow_inf_nan": False}
"""pydantic's configuration of what is read from files and command lines: known fields and finite numbers only."""
Positive = Annotated[float, Within(gt=0.0)]


class WrittenAs:
    """A tuple that a configuration writes with names, those of a NamedTuple."""

    def __init__(self, named: type) -> None:
        self.named = named

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], Any]) -> Any:
        """Return the schema for pydantic, which is not imported here, where cells are computed."""
        return handler(self.named)


@cache
def declared_types(cls: type) -> Mapping[str, Any]:
    """Return the type of each field of a dataclass, without its limits."""
    return get_type_hints(cls)


def changed(item: Any) -> list[str]:
    """Return the names of the fields of a dataclass that have no default, or hold another value."""
    names = []
    for field in fields(item):
        default = field.default if field.default_factory is MISSING else field.default_factory()
        if default is MISSING or getattr(item, field.name) != default:
            names.append(field.name)
    return names


def plain(item: Any, *names: str) -> dict[str, Any]:
    """Return fields of a dataclass as JSON holds them; 10 and 10.0 are one number where the type is float."""
    cls: type = type(item)
    return {name: _plain(declared_types(cls)[name], getattr(item, name)) for name in names}


def _plain(hint: Any, value: Any) -> Any:
    if get_origin(hint) in (Union, types.UnionType):
        hint = next(part for part in get_args(hint) if part is not types.NoneType)
    if value is None:
        return None
    if is_dataclass(hint):
        return value.to_dict()
    arguments = get_args(hint)
    if isinstance(value, Mapping):
        return {key: _plain(arguments[1], value[key]) for key in sorted(value)} if arguments else dict(value)
    if isinstance(value, tuple):
        parts = arguments[:1] * len(value) if arguments[-1:] == (...,) else arguments
        return [_plain(part, item) for part, item in zip(parts, value, strict=True)]
    return float(value) if hint is float else value


def validated(kind: type[Validated], values: Mapping[str, Any], paths: Mapping[str, str] | None = None) -> Validated:
    """Return an instance of a dataclass; raises InputError that names the field by its path in the configuration.

    ``paths`` are by field; that of the empty name stands for the whole, of which a class's own check may complain.
    """
    from pydantic import ValidationError

    try:
        return _adapter(kind).validate_python(dict(values))  # type: ignore[no-any-return,arg-type]
    except ValidationError as error:
        first = error.errors()[0]
        cause = first.get("ctx", {}).get("error")
        if isinstance(cause, InputError):
            raise cause from None
        where, *below = [str(part) for part in first["loc"]] or [""]
        field = ".".join([(paths or {}).get(where, where), *below])
        raise InputError(field, first["input"], first["msg"].lower()) from None


@cache
def _adapter(kind: type[Any]) -> Any:
    from pydantic import TypeAdapter

    return TypeAdapter(kind)
