"""The declaration of a dataclass's fields, and what it is used for: limits on a command line, and the way to JSON.

A field is declared once, in the dataclass that holds it. Its type says how it is written and read, and its default when
it is left out of an identity.
"""

from __future__ import annotations

import re
import types
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin, get_type_hints

from annotated_types import Interval as Within

from bench.errors import InputError, did_you_mean

Validated = TypeVar("Validated")
STRICT: Any = {"extra": "forbid", "allow_inf_nan": False}
"""pydantic's configuration of what is read from files and command lines: known fields and finite numbers only."""
Positive = Annotated[float, Within(gt=0.0)]


class Parsed:
    """A text that a function of ours turns into a value; it raises ValueError with what would be right."""

    def __init__(self, parse: Callable[[str], Any]) -> None:
        self.parse = parse

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], Any]) -> Any:
        """Call the function in place of pydantic's reading."""
        from pydantic_core import core_schema

        return core_schema.no_info_plain_validator_function(self._read)

    def _read(self, text: str) -> Any:
        try:
            return self.parse(text)
        except InputError as error:  # of a part; the whole text is shown
            raise ValueError(error.remedy) from None


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
    """Return the names of the fields of a dataclass that have no default or a different value."""
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


def validated(kind: type[Validated], values: Mapping[str, Any], paths: Mapping[str, str] | str = "") -> Validated:
    """Return an instance of a model or dataclass; raises InputError that names the field as the user wrote it.

    Args:
        kind: the class, whose types are the limits.
        values: plain values by field.
        paths: by field where the configuration has it, that of "" being the whole; or what stands before all fields.
    """
    if isinstance(paths, str):
        paths = {name: f"{paths}.{name}" if paths else name for name in values} | {"": paths}
    return _read(_adapter(kind), dict(values), paths, kind)  # type: ignore[no-any-return,arg-type]


def value_of(kind: Any, value: Any, field: str) -> Any:
    """Return the value of one field by its type, read from a text or taken as it is; raises InputError."""
    parts = map(str, range(len(value) if isinstance(value, tuple) else 0))
    return _read(_value_adapter(kind), value, {"": field, **dict.fromkeys(parts, field)}, kind)


def _read(adapter: Any, values: Any, paths: Mapping[str, str], kind: Any) -> Any:
    from pydantic import ValidationError

    try:
        return adapter.validate_python(values)
    except ValidationError as error:
        raise _bad_input(error.errors()[0], paths, kind) from None


def _bad_input(error: Any, paths: Mapping[str, str], kind: Any) -> InputError:
    """Return pydantic's first objection in the words of a command line."""
    where, *below = [str(part) for part in error["loc"]] or [""]
    field, value = ".".join([paths.get(where, where), *below]), error["input"]
    reason = error.get("ctx", {}).get("error")
    if isinstance(reason, InputError):
        return InputError(reason.field or field, reason.value, reason.remedy)
    if error["type"] == "unexpected_keyword_argument":
        known = [f.name for f in fields(kind) if f.name not in ("name", "kind")] if is_dataclass(kind) else []
        return InputError(field, value, f"not a field; {did_you_mean(where, known)}fields: {', '.join(known)}")
    if error["type"] == "missing":
        return InputError(field, "", "field required")
    if error["type"] == "literal_error":
        known = re.findall("'(.*?)'", error["msg"])
        return InputError(field, value, f"{did_you_mean(value, known)}one of {', '.join(known)}")
    return InputError(field, value, str(reason) if isinstance(reason, ValueError) else error["msg"].lower())


@cache
def _adapter(kind: type[Any]) -> Any:
    """Return the pydantic validator of a class, created once."""
    from pydantic import TypeAdapter

    return TypeAdapter(kind)


def _value_adapter(kind: Any) -> Any:
    from pydantic import TypeAdapter

    return TypeAdapter(kind, config={"allow_inf_nan": False})
