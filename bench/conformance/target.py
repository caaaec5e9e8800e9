"""What is to be checked: a file, a folder with a ``pyproject.toml``, an installed package, or a registered name.

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

METHODS = registry.GROUP
Kind = Literal["method", "system"]
KINDS: Mapping[str, Kind] = {METHODS: "method", SYSTEMS: "system"}
WANTED = "a file, a folder with a pyproject.toml, an installed package, or the name of a registered method or system"


@dataclass(frozen=True)
class Subject:
    """A method or a system: the name that it is, or would be, registered by, and where its class stands."""

    kind: Kind
    name: str
    value: str


@dataclass(frozen=True)
class Target:
    """What a command line names: subjects, or a ``module`` in which they are to be looked for.

    ``paths`` must be importable from. ``installed``: whether its entry points are known already. ``settings``: those
    of its methods, and the options of its systems, by kind.
    """

    text: str
    subjects: tuple[Subject, ...] = ()
    module: str = ""
    paths: tuple[str, ...] = ()
    installed: bool = False
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


def read_target(text: str, settings: Mapping[str, Mapping[str, Any]] | None = None) -> Target:
    """Find what a text names; raises InputError where it names nothing."""
    path, own = Path(text), dict(settings or {})
    if os.path.isdir(path):
        return _project(path, own)
    if path.suffix == ".py":
        if not os.path.isfile(path):
            raise InputError("package", text, "it is no file" if os.path.exists(path) else "there is no such file")
        if not path.stem.isidentifier():
            raise InputError("package", text, "a file that can be imported: letters, digits and _ in its name")
        return Target(text, module=path.stem, paths=(str(path.parent.resolve()),), settings=own)
    known = [*_subjects(registry.registered()), *_subjects(registered_systems())]
    named = [subject for subject in known if subject.name == text] or [
        subject for subject in known if subject.value.partition(":")[0].partition(".")[0] == text
    ]
    named = named or [subject for subject in known if _distribution(subject) == _normal(text)]
    if named:
        return Target(text, tuple(named), installed=True, settings=own)
    if re.fullmatch(r"\w+(\.\w+)*", text) and _importable(text):
        return Target(text, module=text, settings=own)
    raise InputError("package", text, WANTED)


def _project(folder: Path, settings: Mapping[str, Mapping[str, Any]]) -> Target:
    path = folder / "pyproject.toml"
    try:
        content = tomllib.loads(read_regular(path).decode())
    except OSError:
        raise InputError("package", folder, "it has no pyproject.toml; name the file of the class instead") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError("package", path, f"cannot be read: {one_line(error)}") from None
    found = []
    for group, kind in KINDS.items():
        points = _below(content, "project", "entry-points", group)
        found += [Subject(kind, name, _point(path, name, value)) for name, value in points.items()]
    if not found:
        remedy = f'register a class in it, under [project.entry-points."{METHODS}"] or ."{SYSTEMS}"'
        raise InputError("package", path, remedy)
    places = (folder / "src", folder)
    return Target(str(folder), tuple(found), paths=tuple(str(p.resolve()) for p in places), settings=settings)


def _below(content: Any, *names: str) -> Mapping[str, Any]:
    """The table of some name within tables; an empty one where any of them is none."""
    for name in names:
        content = content.get(name) if isinstance(content, dict) else None
    return content if isinstance(content, dict) else {}


def _point(path: Path, name: str, value: Any) -> str:
    """What an entry point names; raises InputError for what names no class."""
    if not isinstance(value, str) or not re.fullmatch(r"\w+(\.\w+)*:\w+(\.\w+)*", value):
        raise InputError("package", path, f"its entry point {name} is {value!r}; write '<module>:<class>'")
    if not re.fullmatch(r"[\w.-]+", name):
        raise InputError("package", path, f"its entry point {name!r}: a name of letters, digits, _, - and .")
    return value


def _subjects(points: Mapping[str, EntryPoint]) -> list[Subject]:
    return [Subject(KINDS[point.group], name, point.value) for name, point in points.items()]


def _distribution(subject: Subject) -> str:
    points = registry.registered() if subject.kind == "method" else registered_systems()
    distribution = points[subject.name].dist
    return _normal(distribution.name) if distribution is not None else ""


def _normal(name: str) -> str:
    """The name of a distribution as indexes compare it (PEP 503)."""
    return re.sub(r"[-_.]+", "-", name).lower()


def _importable(text: str) -> bool:
    """Whether there is a package to import; what is below it is looked for where it is imported."""
    try:
        return find_spec(text.partition(".")[0]) is not None
    except (ImportError, ValueError):
        return False
