"""Registered methods: entry points of the group ``bench.methods``, of this and other packages."""

from __future__ import annotations

import dataclasses
import importlib.util
from collections.abc import Collection, Iterable, Mapping
from functools import cache
from importlib.metadata import EntryPoint
from typing import Any, TypeVar

from bench.contract.method import Identifier
from bench.entrants.reference import REFERENCES
from bench.entry_points import entry_points_of, load_entry_point
from bench.errors import InputError, did_you_mean
from bench.scenario.declaration import validated

GROUP = "bench.methods"
DISTRIBUTION = "vibration-bench"
Made = TypeVar("Made")


def registered() -> dict[str, EntryPoint]:
    """Return the entry points by method name, without importing anything."""
    return entry_points_of(GROUP)


def method_names() -> list[str]:
    """Return the names of methods and reference rows; ``method=`` also accepts the variants in ``conf/method``."""
    return [*registered(), *REFERENCES]


@cache
def load_method(name: str) -> type[Identifier]:
    """Return the class of a method. Raises InputError if the name is unknown or its entry point cannot be imported."""
    cls: type[Identifier] = load_dataclass(registered(), name, Identifier, method_names())
    return cls


def load_dataclass(points: Mapping[str, EntryPoint], name: str, base: type, names: Collection[str]) -> Any:
    """Return the dataclass below ``base`` that is registered by a name; raises InputError, which lists ``names``."""
    loaded = load_entry_point("method", name, points, base, names)
    if not dataclasses.is_dataclass(loaded):
        raise InputError("method", name, f"its entry point ({points[name].value}) must name a dataclass")
    return loaded


def default_settings(name: str) -> dict[str, Any]:
    """Return the settings of a method with their defaults; none for a reference row."""
    known = {} if name in REFERENCES else _defaults(load_method(name), name)
    return {key: list(value) if isinstance(value, tuple | list) else value for key, value in known.items()}


@cache
def _defaults(cls: type[Identifier], name: str) -> dict[str, Any]:
    settings = {}
    for field in dataclasses.fields(cls):  # type: ignore[arg-type]
        if field.default is not dataclasses.MISSING:
            settings[field.name] = field.default
        elif field.default_factory is not dataclasses.MISSING:
            settings[field.name] = field.default_factory()
        else:
            raise InputError("method", name, f"its setting {field.name} has no default")
    return settings


def make_method(name: str, settings: dict[str, Any]) -> Identifier:
    """Return a method with validated settings; raises InputError that names the setting."""
    return make(load_method(name), name, settings, default_settings(name))


def make(cls: type[Made], name: str, settings: Mapping[str, Any], known: Iterable[str]) -> Made:
    """Return an instance of a registered class; raises InputError for a setting that is unknown or not valid."""
    for key in settings:
        if key not in known:
            near = did_you_mean(key, list(known))
            raise InputError(f"method.{key}", settings[key], f"{near}settings of {name}: {', '.join(known) or 'none'}")
    try:
        return validated(cls, settings, "method")
    except InputError as error:
        if error.field in settings:  # raised by the method, which need not know the prefix
            raise InputError(f"method.{error.field}", error.value, error.remedy) from None
        raise


def missing_package(name: str) -> str | None:
    """Return the install line for the first package that a method needs and this environment lacks, or None."""
    if name in REFERENCES:
        return None
    method = load_method(name)
    for package in method.requires:
        if importlib.util.find_spec(package) is None:
            target = f"'{DISTRIBUTION}[{method.extra}]'" if method.extra else package
            return f"{name} needs {package}: pip install {target}"
    return None
