"""The registered methods: entry points of the group ``bench.methods``, ours and anybody's alike."""

from __future__ import annotations

import dataclasses
import importlib.util
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from bench.contract.method import Identifier
from bench.entrants.reference import REFERENCES
from bench.errors import InputError
from bench.scenario.declaration import validated

GROUP = "bench.methods"
DISTRIBUTION = "vibration-bench"


@cache
def registered() -> dict[str, EntryPoint]:
    """Entry points by method name; nothing is imported."""
    return {point.name: point for point in sorted(entry_points(group=GROUP), key=lambda point: point.name)}


def method_names() -> list[str]:
    """All that ``method=`` accepts beside the variants in ``conf/method``: methods and reference rows."""
    return [*registered(), *REFERENCES]


@cache
def load_method(name: str) -> type[Identifier]:
    """The class behind a name. Raises InputError for an unknown name or an entry point that does not load."""
    if name not in registered():
        raise InputError("method", name, f"known methods: {', '.join(method_names())}")
    try:
        loaded = registered()[name].load()
    except Exception as error:
        raise InputError("method", name, f"its entry point does not load ({type(error).__name__}: {error})") from None
    if not (isinstance(loaded, type) and issubclass(loaded, Identifier) and dataclasses.is_dataclass(loaded)):
        raise InputError("method", name, "its entry point must name a dataclass that subclasses bench.Identifier")
    return loaded


def default_settings(name: str) -> dict[str, Any]:
    """The settings of a method with their defaults; none for a reference row."""
    if name in REFERENCES:
        return {}
    settings = {}
    for field in dataclasses.fields(load_method(name)):  # type: ignore[arg-type]
        if field.default is not dataclasses.MISSING:
            settings[field.name] = field.default
        elif field.default_factory is not dataclasses.MISSING:
            settings[field.name] = field.default_factory()
        else:
            raise InputError("method", name, f"its setting {field.name} has no default")
    return {key: list(value) if isinstance(value, tuple) else value for key, value in settings.items()}


def make_method(name: str, settings: dict[str, Any]) -> Identifier:
    """An instance with validated settings; raises InputError that names the setting."""
    known = default_settings(name)
    for key in settings:
        if key not in known:
            raise InputError(f"method.{key}", settings[key], f"settings of {name}: {', '.join(known) or 'none'}")
    return validated(load_method(name), settings, {"": "method", **{key: f"method.{key}" for key in settings}})


def missing_package(name: str) -> str | None:
    """The install line for the first package that a method needs and this environment lacks, or None."""
    if name in REFERENCES:
        return None
    method = load_method(name)
    for package in method.requires:
        if importlib.util.find_spec(package) is None:
            target = f"'{DISTRIBUTION}[{method.extra}]'" if method.extra else package
            return f"{name} needs {package}: pip install {target}"
    return None
