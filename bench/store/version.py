"""Versions of the code that computes a cell: whole numbers of its method, its system and the scoring.

They are raised by hand when a change alters results. A stored cell is current if all three agree with today's code, and
so do the versions of classes that other packages supply to the method. Versions of packages are recorded, but do not
make a cell stale.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
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
CONDITIONS: Mapping[str, Callable[[Mapping[str, Any]], bool]] = {
    "forces": lambda description: bool((description.get("data") or {}).get("force")),
    "prior": lambda description: bool((description.get("told") or {}).get("prior")),
    "unknown_start": lambda description: (description.get("told") or {}).get("initial_state") == "unknown",
}
"""Conditions on the description of a cell: a known force, a prior, and an unknown initial state."""
PACKAGES = ("numpy", "scipy")
"""Packages that all fits and the scoring use."""


@dataclass(frozen=True)
class Version:
    """The versions of method, system and scoring, and the names of the packages in use.

    ``parts``: versions of what the method does under the :data:`CONDITIONS` that hold for a cell.
    ``supplied``: versions of classes that other packages supply, by setting and class (``optimizer my_package:Lion``).
    """

    method: int
    system: int
    scoring: int
    requires: tuple[str, ...] = PACKAGES
    parts: tuple[tuple[str, int], ...] = ()
    supplied: tuple[tuple[str, int], ...] = ()

    @property
    def packages(self) -> Mapping[str, str]:
        """The versions of the packages in use that are installed, by import name."""
        versions = {name: installed(name) for name in self.requires}
        return {name: version for name, version in versions.items() if version}

    def as_json(self) -> dict[str, int]:
        """Return the numbers as they are stored in a cell."""
        return {**{name: getattr(self, name) for name in NUMBERS}, **dict(self.parts), **dict(self.supplied)}

    def changed_since(self, stored: Mapping[str, Any]) -> str:
        """Describe the numbers that differ from a stored version in one line; empty if none differs."""
        today = self.as_json()
        return ", ".join(
            f"{name} version {stored.get(name, 'not stated')}, today {today.get(name, 'not used')}"
            for name in {**today, **stored}
            if stored.get(name) != today.get(name)
        )

    def matches(self, stored: Mapping[str, Any]) -> bool:
        """Return whether a stored version has the same numbers."""
        return not self.changed_since(stored)


@cache
def cell_version(method: str, system: str) -> Version:
    """Return the version for cells of a method or reference on a system; raises InputError for an unknown name."""
    if method in REFERENCES:
        return Version(scoring.VERSION, load_system(system).version, scoring.VERSION)
    loaded = load_method(method)
    return Version(loaded.version, load_system(system).version, scoring.VERSION, (*PACKAGES, *loaded.requires))


def described_version(description: Mapping[str, Any]) -> Version:
    """Return today's version for a description of a cell, some settings of which other packages may supply.

    Raises:
        InputError: A name is unknown, or no installed package supplies the value of a setting.
    """
    data, settings = description.get("data") or {}, description.get("settings") or {}
    method = str(description.get("method"))
    version = cell_version(method, str(data.get("system")))
    if method in REFERENCES:
        return version
    loaded = load_method(method)
    for unknown in sorted(set(loaded.parts) - set(CONDITIONS)):
        raise InputError("method", method, f"its parts name {unknown}; conditions are {', '.join(CONDITIONS)}")
    parts = tuple((name, number) for name, number in loaded.parts.items() if CONDITIONS[name](description))
    card = getattr(loaded, "card", None)
    supplied = {}
    for name, choices in (card.choices if card else {}).items():
        value = str(settings.get(name))
        if name in settings and value not in choices:
            raise InputError(f"method.{name}", value, "no installed package supplies it")
        if name in settings and choices[value].supplier:
            supplied[f"{name} {choices[value].supplier}"] = choices[value]
    requires = tuple(choice.package for choice in supplied.values() if choice.package)
    numbers = tuple((name, choice.version) for name, choice in supplied.items())
    return replace(version, requires=(*version.requires, *requires), parts=parts, supplied=numbers)


def bound_version(system: str) -> list[int]:
    """Return the version for the bounds of a system."""
    return [load_system(system).version, scoring.VERSION]


@cache
def installed(name: str) -> str:
    """Return the public version of a package; empty if it is not installed."""
    with contextlib.suppress(PackageNotFoundError):
        return version(name).partition("+")[0]
    if find_spec(name) is None:
        return ""
    for distribution in packages_distributions().get(name, []):  # the distribution may have another name
        return version(distribution).partition("+")[0]
    return ""
