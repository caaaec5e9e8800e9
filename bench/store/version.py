"""What computes a cell: the whole numbers that its method, its system and the scoring carry as versions.

A number is raised by hand where a change alters results. A stored cell is current where all three are today's; the
versions of the packages are recorded beside them and make nothing stale.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from typing import Any

from bench import scoring
from bench.entrants.reference import REFERENCES
from bench.entrants.registry import load_method
from bench.systems import load_system

NUMBERS = ("method", "system", "scoring")
PACKAGES = ("numpy", "scipy")
"""Packages that every fit and its scores use."""


@dataclass(frozen=True)
class Version:
    """The versions of the method, the system and the scoring, and those of the packages in use, by name."""

    method: int
    system: int
    scoring: int
    packages: Mapping[str, str]

    def as_json(self) -> dict[str, int]:
        """Return what a stored cell states."""
        return {name: getattr(self, name) for name in NUMBERS}

    def is_that_of(self, stored: Mapping[str, Any]) -> bool:
        """Return whether a stored version has the same three numbers."""
        return all(stored.get(name) == getattr(self, name) for name in NUMBERS)

    def changes(self, stored: Mapping[str, Any]) -> list[str]:
        """Describe each number that differs from a stored version's."""
        return [
            f"{name} version {stored.get(name, 'not stated')}, today {getattr(self, name)}"
            for name in NUMBERS
            if stored.get(name) != getattr(self, name)
        ]

    def changed_since(self, stored: Mapping[str, Any]) -> str:
        """Describe the same in one line."""
        return ", ".join(self.changes(stored))


@cache
def cell_version(method: str, system: str) -> Version:
    """Return the version of what computes the cells of a method, or of a reference row, on a system.

    Raises InputError for an unknown name.
    """
    if method in REFERENCES:
        return Version(scoring.VERSION, load_system(system).version, scoring.VERSION, _installed(PACKAGES))
    found = load_method(method)
    packages = _installed((*PACKAGES, *found.requires))
    return Version(found.version, load_system(system).version, scoring.VERSION, packages)


def bound_version(system: str) -> list[int]:
    """Return the version of what computes the bounds of a system."""
    return [load_system(system).version, scoring.VERSION]


def _installed(names: tuple[str, ...]) -> dict[str, str]:
    """Return the public versions of the packages that are installed, by the name that is imported."""
    found = {}
    for name in names:
        for distribution in (name, *_distributions(name)):
            with contextlib.suppress(PackageNotFoundError):
                found[name] = version(distribution).partition("+")[0]
                break
    return found


def _distributions(name: str) -> Iterator[str]:
    """Yield the distributions that hold a package of another name; looking for them takes a tenth of a second."""
    yield from packages_distributions().get(name, [])
