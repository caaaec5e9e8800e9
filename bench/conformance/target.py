"""The target of a check: a file, a folder with a ``pyproject.toml``, an installed package, or a registered name.

Somebody else's code is imported in a process of its own (:mod:`bench.conformance.process`), never where a command runs.
"""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

from bench.entrants import registry
from bench.errors import InputError
from bench.isolation.failure import one_line
from bench.store.seal import read_regular
from bench.systems import GROUP as SYSTEMS
from bench.systems import registered_systems

Kind = Literal["method", "system"]
KINDS: Mapping[str, Kind] = {registry.GROUP: "method", SYSTEMS: "system"}
"""What is registered in each group of entry points."""
WANTED = "a file, a folder with a pyproject.toml, an installed package, or the name of a registered method or system"


@dataclass(frozen=True)
class Subject:
    """A method or a system: the name that it is, or would be, registered by, and where its class stands."""

    kind: Kind
    name: str
    value: str


@dataclass(frozen=True)
class Target:
    """What a command line names.

    Attributes:
        text: The name as it was written.
        subjects: The methods and systems, where these are known without an import.
        module: Else the module in which they are looked for.
        paths: Folders to import from.
        installed: Whether its entry points are registered.
        settings: Settings of methods and options of systems, by kind.
    """

    text: str
    subjects: tuple[Subject, ...] = ()
    module: str = ""
    paths: tuple[str, ...] = ()
    installed: bool = False
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


def read_target(text: str, settings: Mapping[str, Mapping[str, Any]] | None = None) -> Target:
    """Find what a text names; raises InputError where it names nothing."""
    path, given = Path(text), dict(settings or {})
    if os.path.isdir(path):
        places = tuple(str(place.resolve()) for place in (path / "src", path))
        return Target(text, _entry_points(path), paths=places, settings=given)
    if path.suffix == ".py":
        if not os.path.isfile(path):
            raise InputError("package", text, "it is no file" if os.path.exists(path) else "there is no such file")
        if not path.stem.isidentifier():
            raise InputError("package", text, "a file that can be imported: letters, digits and _ in its name")
        return Target(text, module=path.stem, paths=(str(path.parent.resolve()),), settings=given)
    points = [*registry.registered().values(), *registered_systems().values()]
    for names in (_name, _package, _distribution):
        named = tuple(Subject(KINDS[p.group], p.name, p.value) for p in points if names(p) == names(text))
        if named:
            return Target(text, named, installed=True, settings=given)
    if re.fullmatch(r"\w+(\.\w+)*", text) and _can_be_imported(text):
        return Target(text, module=text, settings=given)
    raise InputError("package", text, WANTED)


def _name(point: EntryPoint | str) -> str:
    return point if isinstance(point, str) else point.name


def _package(point: EntryPoint | str) -> str:
    return point if isinstance(point, str) else point.module.partition(".")[0]


def _distribution(point: EntryPoint | str) -> str:
    """Return the name of a distribution as indexes compare it (PEP 503)."""
    name = point if isinstance(point, str) else point.dist.name if point.dist is not None else ""
    return re.sub(r"[-_.]+", "-", name).lower()


def _entry_points(folder: Path) -> tuple[Subject, ...]:
    """Return the methods and systems that the ``pyproject.toml`` of a folder registers; raises InputError."""
    path = folder / "pyproject.toml"
    try:
        content: Any = tomllib.loads(read_regular(path).decode())
    except OSError:
        raise InputError("package", folder, "it has no pyproject.toml; name the file of the class instead") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError("package", path, f"cannot be read: {one_line(error)}") from None
    for name in ("project", "entry-points"):
        content = content.get(name) if isinstance(content, dict) else None
    groups = content if isinstance(content, dict) else {}
    subjects = []
    for group, kind in KINDS.items():
        points = groups.get(group)
        for name, value in (points if isinstance(points, dict) else {}).items():
            if not isinstance(value, str) or not re.fullmatch(r"\w+(\.\w+)*:\w+(\.\w+)*", value):
                raise InputError("package", path, f"its entry point {name} is {value!r}; write '<module>:<class>'")
            if not re.fullmatch(r"[\w.-]+", name):
                raise InputError("package", path, f"its entry point {name!r}: a name of letters, digits, _, - and .")
            subjects.append(Subject(kind, name, value))
    if not subjects:
        groups_named = " or ".join(f'[project.entry-points."{group}"]' for group in KINDS)
        raise InputError("package", path, f"register a class in it, under {groups_named}")
    return tuple(subjects)


def _can_be_imported(text: str) -> bool:
    """Whether there is such a package; its modules are looked for where it is imported."""
    try:
        return find_spec(text.partition(".")[0]) is not None
    except (ImportError, ValueError):
        return False
