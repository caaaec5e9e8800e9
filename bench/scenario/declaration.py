"""What the declaration of a dataclass's fields is used for: limits on a command line, and both ways to JSON.

A field is declared once, in the dataclass that holds it. Its type says how it is written and read, its default when it
is left out of an identity, and its metadata where it stands in a configuration and in the identity.
"""

from __future__ import annotations

import types
from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from functools import cache
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin, get_type_hints

from bench.errors import InputError

Validated = TypeVar("Validated")

STRICT: Any = {"extra": "forbid", "allow_inf_nan": False}
"""pydantic's configuration of what is read from files and command lines: known fields and finite numbers only."""


class Within:
    """Limits of a number in a configuration, as pydantic names them: ``Within(gt=0)``, ``Within(ge=3, le=100)``."""

    def __init__(self, **limits: float) -> None:
        self.limits = limits

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], Any]) -> Any:
        """How pydantic asks for them; so it is not imported here, where cells are computed."""
        return {**handler(source), **self.limits}


Positive = Annotated[float, Within(gt=0.0)]


class WrittenAs:
    """A tuple that a configuration writes with names, those of a NamedTuple."""

    def __init__(self, named: type) -> None:
        self.named = named

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], Any]) -> Any:
        """How pydantic asks for it."""
        return handler(self.named)


@cache
def declared_types(cls: type) -> Mapping[str, Any]:
    """The type of each field of a dataclass, without its limits."""
    return get_type_hints(cls)


def is_default(field: Field[Any], value: Any) -> bool:
    """Whether a field holds its default; never where it has none."""
    default = field.default if field.default_factory is MISSING else field.default_factory()
    return default is not MISSING and bool(value == default)


def plain(cls: type, name: str, value: Any) -> Any:
    """The value of a field as JSON holds it; numbers as their type says, so that 10 and 10.0 are one float."""
    return _plain(declared_types(cls)[name], value)


def restored(cls: type, name: str, value: Any) -> Any:
    """The value of a field from what :func:`plain` made of it."""
    return _restored(declared_types(cls)[name], value)


def changed(item: Any, *apart: str) -> dict[str, Any]:
    """The fields of a dataclass that are not at their defaults, but those named ``apart``, as JSON holds them."""
    return {
        f.name: plain(type(item), f.name, getattr(item, f.name))
        for f in fields(item)
        if f.name not in apart and not is_default(f, getattr(item, f.name))
    }


def _without_none(hint: Any) -> Any:
    union = get_origin(hint) in (Union, types.UnionType)
    return next(part for part in get_args(hint) if part is not types.NoneType) if union else hint


def _plain(hint: Any, value: Any) -> Any:
    hint = _without_none(hint)
    if is_dataclass(hint) and value is not None:
        return value.to_dict()
    if isinstance(value, Mapping):
        arguments = get_args(hint)
        return {key: _plain(arguments[1], value[key]) for key in sorted(value)} if arguments else dict(value)
    if isinstance(value, tuple):
        return [_plain(part, item) for part, item in zip(_parts(hint, len(value)), value, strict=True)]
    return float(value) if hint is float and value is not None else value


def _restored(hint: Any, value: Any) -> Any:
    hint = _without_none(hint)
    if is_dataclass(hint) and value is not None:
        return hint.from_dict(value)  # type: ignore[union-attr]
    if isinstance(value, list) and get_origin(hint) is tuple:
        return tuple(_restored(part, item) for part, item in zip(_parts(hint, len(value)), value, strict=True))
    return value


def _parts(hint: Any, n: int) -> list[Any]:
    """The types of the items of a tuple."""
    arguments = get_args(hint)
    return [arguments[0]] * n if arguments[-1:] == (...,) else list(arguments)


def validated(kind: type[Validated], values: Mapping[str, Any], paths: Mapping[str, str] | None = None) -> Validated:
    """An instance of a model or dataclass; raises InputError that names the field by its path in the configuration.

    ``paths`` are by field; that of the empty name stands for the whole, of which a class's own check may complain.
    """
    from pydantic import ValidationError

    try:
        return _adapter(kind).validate_python(dict(values))  # type: ignore[no-any-return,arg-type]
    except ValidationError as error:
        first = error.errors()[0]
        own = first.get("ctx", {}).get("error")
        if isinstance(own, InputError):
            raise own from None
        where, *below = [str(part) for part in first["loc"]] or [""]
        field = ".".join([(paths or {}).get(where, where), *below])
        raise InputError(field, first["input"], first["msg"].lower()) from None


@cache
def _adapter(kind: type[Any]) -> Any:
    """pydantic's validation of a class, made once."""
    from pydantic import TypeAdapter

    return TypeAdapter(kind)
