"""Find the subjects of a check: a file, a folder with a ``pyproject.toml``, an installed package or a registered name.

They are imported and created in a separate process (:mod:`bench.conformance.process`).
"""

from __future__ import annotations

import contextlib
import importlib
import inspect
import os
import re
import sys
import tomllib
from collections.abc import Mapping
from importlib.metadata import EntryPoint, PackageNotFoundError, distribution
from pathlib import Path
from typing import Any, Literal, NamedTuple

from bench.config.limits import check_numbers, check_system
from bench.conformance.method_checks import Candidate
from bench.conformance.system_checks import Specimen
from bench.contract.method import Identifier
from bench.entrants import registry
from bench.errors import InputError
from bench.files import read_regular
from bench.isolation.failure import one_line
from bench.systems import GROUP, System, make_system, registered_systems

Kind = Literal["method", "system"]
KINDS: Mapping[str, Kind] = {registry.GROUP: "method", GROUP: "system"}
"""Kind of the subjects of each group of entry points."""


class Subject(NamedTuple):
    """A method or a system: kind, registered name, and location of its class."""

    kind: Kind
    name: str
    value: str


def subjects_of(text: str) -> list[Subject]:
    """Return the subjects that a text names, and make them importable; raises InputError if it names none."""
    path, place = Path(text), os.path.abspath(text)
    if os.path.isdir(path):
        sys.path[:0] = [os.path.join(place, "src"), place]
        return _declared(path)
    if path.suffix == ".py" and path.stem.isidentifier() and os.path.isfile(path):
        sys.path.insert(0, os.path.dirname(place))
        return _defined(path)
    points = [*registry.registered().values(), *registered_systems().values()]
    named = [p for p in points if p.name == text] or [p for p in points if p.module.partition(".")[0] == text]
    with contextlib.suppress(PackageNotFoundError, ValueError):
        named = named or [point for point in distribution(text).entry_points if point.group in KINDS]
    if not named:
        wanted = "a folder with a pyproject.toml, an installed package, or the name of a registered method or system"
        raise InputError("package", text, f"there is no such file that can be imported; name one, or {wanted}")
    return [Subject(KINDS[point.group], point.name, point.value) for point in named]


def _declared(folder: Path) -> list[Subject]:
    """Return the methods and systems that the ``pyproject.toml`` of a folder registers; raises InputError."""
    path, subjects = folder / "pyproject.toml", []
    try:
        groups = tomllib.loads(read_regular(path).decode())["project"]["entry-points"]
        subjects = [Subject(kind, *point) for group, kind in KINDS.items() for point in groups.get(group, {}).items()]
    except OSError:
        raise InputError("package", folder, "it has no pyproject.toml; name the file of the class instead") from None
    except (ValueError, RecursionError) as error:
        raise InputError("package", path, f"cannot be read: {one_line(error)}") from None
    except (KeyError, TypeError, AttributeError):
        pass
    if not subjects or not all(re.fullmatch(r"[\w.-]+", s.name) and isinstance(s.value, str) for s in subjects):
        groups_named = " or ".join(f'[project.entry-points."{group}"]' for group in KINDS)
        remedy = f"register a class under {groups_named}, by a name of letters, digits, _, - and ."
        raise InputError("package", path, f"{remedy}, as '<module>:<class>'")
    return subjects


def _defined(path: Path) -> list[Subject]:
    """Return the methods and systems that a file defines; raises InputError if there are none."""
    try:
        module = importlib.import_module(path.stem)
    except Exception as error:
        raise InputError("package", path, f"cannot be imported: {one_line(error)}") from None
    subjects = []
    for name, item in vars(module).items():
        if not inspect.isclass(item) or item.__module__ != module.__name__ or inspect.isabstract(item):
            continue
        value = f"{item.__module__}:{item.__qualname__}"
        if issubclass(item, System):
            subjects.append(Subject("system", str(item.name), value))
        elif issubclass(item, Identifier):
            subjects.append(Subject("method", re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower(), value))
    if not subjects:
        raise InputError(
            "package",
            path,
            "no class in it subclasses bench.Identifier or bench.System; "
            "a part of a method is checked with it: package=<method> method.<setting>=<part>",
        )
    return subjects


def made(subject: Subject, settings: dict[str, Any]) -> Candidate | Specimen:
    """Register a subject in this process, as if it were installed, and create it with its settings."""
    kind, name, value = subject
    points = registry.registered() if kind == "method" else registered_systems()
    if (name in points and points[name].value != value) or name in registry.REFERENCES:
        raise InputError(kind, name, "the benchmark has one of that name; choose another")
    points[name] = EntryPoint(name, value, kind)
    if kind == "method":
        if missing := registry.missing_package(name):
            raise InputError("package", name, missing)
        return Candidate(registry.make_method(name, settings))
    try:
        check_numbers({"system": {"options": settings}})
        check_system(name, settings)
    except InputError as error:
        raise InputError(error.field.replace("system.options.", "system."), error.value, error.remedy) from None
    return Specimen(name, settings, make_system(name, settings))
