"""The target of a check: a file, a folder with a ``pyproject.toml``, an installed package, or a registered name.

Somebody else's code is imported in a process of its own (:mod:`bench.conformance.process`), never where a command runs.
"""

from __future__ import annotations

import contextlib
import os
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any, Literal, NamedTuple

from bench.entrants import registry
from bench.errors import InputError
from bench.files import read_regular
from bench.isolation.failure import one_line
from bench.systems import GROUP as SYSTEMS
from bench.systems import registered_systems

Kind = Literal["method", "system"]
KINDS: Mapping[str, Kind] = {registry.GROUP: "method", SYSTEMS: "system"}
"""The kind of subject that is registered in each group of entry points."""


class Subject(NamedTuple):
    """A method or a system: the name that it is, or would be, registered by, and where its class stands."""

    kind: Kind
    name: str
    value: str


@dataclass(frozen=True)
class Target:
    """The methods and systems that a command line names.

    Attributes:
        text: The name as it was written.
        settings: Settings of methods and options of systems, by kind.
        subjects: The methods and systems, where these are known without an import.
        module: Else the module in which they are looked for.
        paths: Folders to import from.
    """

    text: str
    settings: Mapping[str, Mapping[str, Any]]
    subjects: tuple[Subject, ...] = ()
    module: str = ""
    paths: tuple[str, ...] = ()


def read_target(text: str, settings: Mapping[str, Mapping[str, Any]]) -> Target:
    """Return what a text names; raises InputError where it names nothing."""
    path, place = Path(text), os.path.abspath(text)
    if os.path.isdir(path):
        return Target(text, settings, _declared(path), paths=(os.path.join(place, "src"), place))
    if path.suffix == ".py" and path.stem.isidentifier() and os.path.isfile(path):
        return Target(text, settings, module=path.stem, paths=(os.path.dirname(place),))
    points = [*registry.registered().values(), *registered_systems().values()]
    named = [p for p in points if p.name == text] or [p for p in points if p.module.partition(".")[0] == text]
    with contextlib.suppress(PackageNotFoundError, ValueError):
        named = named or [point for point in distribution(text).entry_points if point.group in KINDS]
    if not named:
        wanted = "a folder with a pyproject.toml, an installed package, or the name of a registered method or system"
        raise InputError("package", text, f"there is no such file that can be imported; name one, or {wanted}")
    return Target(text, settings, tuple(Subject(KINDS[point.group], point.name, point.value) for point in named))


def _declared(folder: Path) -> tuple[Subject, ...]:
    """Return the methods and systems that the ``pyproject.toml`` of a folder registers; raises InputError."""
    path = folder / "pyproject.toml"
    try:
        groups = tomllib.loads(read_regular(path).decode())["project"]["entry-points"]
        subjects = [
            Subject(kind, str(name), str(value))
            for group, kind in KINDS.items()
            for name, value in groups.get(group, {}).items()
        ]
    except OSError:
        raise InputError("package", folder, "it has no pyproject.toml; name the file of the class instead") from None
    except (ValueError, RecursionError) as error:
        raise InputError("package", path, f"cannot be read: {one_line(error)}") from None
    except (KeyError, TypeError, AttributeError):
        subjects = []
    if not subjects or not all(re.fullmatch(r"[\w.-]+", subject.name) for subject in subjects):
        groups_named = " or ".join(f'[project.entry-points."{group}"]' for group in KINDS)
        remedy = f"register a class under {groups_named}, by a name of letters, digits, _, - and ."
        raise InputError("package", path, f"{remedy}, as '<module>:<class>'")
    return tuple(subjects)
