"""What computes a cell: the whole numbers that its method, its system and the scoring carry as versions.

A number is raised by hand where a change alters results. A stored cell is current where all three are today's, and so
are those of classes that other packages supply to the method; the versions of the packages are recorded beside them
and make nothing stale.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from importlib.util import find_spec
from typing import Any

from bench import scoring
from bench.entrants.reference import REFERENCES
from bench.entrants.registry import load_method
from bench.errors import InputError
from bench.systems import load_system

NUMBERS = ("method", "system", "scoring")
PACKAGES = ("numpy", "scipy")
"""Packages that every fit and its scores use."""


@dataclass(frozen=True)
class Version:
    """The versions of the method, the system and the scoring, and the names of the packages in use.

    ``supplied``: by setting and class (``optimizer my_package:Lion``), the version of what another package supplies.
    """

    method: int
    system: int
    scoring: int
    requires: tuple[str, ...] = PACKAGES
    supplied: tuple[tuple[str, int], ...] = ()

    @property
    def packages(self) -> Mapping[str, str]:
        """The public versions of the packages in use that are installed, by the name that is imported."""
        versions = {name: installed(name) for name in self.requires}
        return {name: version for name, version in versions.items() if version}

    def as_json(self) -> dict[str, int]:
        """Return what a stored cell states."""
        return {**{name: getattr(self, name) for name in NUMBERS}, **dict(self.supplied)}

    def changed_since(self, stored: Mapping[str, Any]) -> str:
        """Describe each number that differs from a stored version's, in one line; nothing where none does."""
        today = self.as_json()
        return ", ".join(
            f"{name} version {stored.get(name, 'not stated')}, today {today.get(name, 'not used')}"
            for name in {**today, **stored}
            if stored.get(name) != today.get(name)
        )

    def is_that_of(self, stored: Mapping[str, Any]) -> bool:
        """Return whether a stored version has the same numbers."""
        return not self.changed_since(stored)


@cache
def cell_version(method: str, system: str) -> Version:
    """Return the version of what computes the cells of a method, or of a reference row, on a system.

    Raises InputError for an unknown name.
    """
    if method in REFERENCES:
        return Version(scoring.VERSION, load_system(system).version, scoring.VERSION)
    found = load_method(method)
    return Version(found.version, load_system(system).version, scoring.VERSION, (*PACKAGES, *found.requires))


def settings_version(method: str, system: str, settings: Mapping[str, Any]) -> Version:
    """Return the version of what computes the cells of a method with settings, whose values others may supply.

    Raises InputError for an unknown name, also of a value that no installed package supplies.
    """
    version = cell_version(method, system)
    card = None if method in REFERENCES else getattr(load_method(method), "card", None)
    supplied = {}
    for name, choices in (card.choices if card else {}).items():
        value = str(settings.get(name))
        if name in settings and value not in choices:
            raise InputError(f"method.{name}", value, "no installed package supplies it")
        if name in settings and choices[value].supplier:
            supplied[f"{name} {choices[value].supplier}"] = choices[value]
    requires = tuple(choice.package for choice in supplied.values() if choice.package)
    numbers = tuple((name, choice.version) for name, choice in supplied.items())
    return replace(version, requires=(*version.requires, *requires), supplied=numbers) if supplied else version


def bound_version(system: str) -> list[int]:
    """Return the version of what computes the bounds of a system."""
    return [load_system(system).version, scoring.VERSION]


@cache
def installed(name: str) -> str:
    """Return the public version of a package, or nothing."""
    with contextlib.suppress(PackageNotFoundError):
        return version(name).partition("+")[0]
    if find_spec(name) is None:
        return ""
    for distribution in packages_distributions().get(name, []):  # a package that its distribution calls otherwise
        return version(distribution).partition("+")[0]
    return ""
