"""What computes a cell: the definitions that its method, its system and the scoring use, and their packages' versions.

Two versions that differ name the modules and packages in which they do.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from typing import Any

from bench.entrants import registry
from bench.entrants.reference import REFERENCES
from bench.scenario.disturbance import kinds
from bench.store.source import Definition, uses
from bench.systems import registered_systems

HARNESS = "bench"
SCORING: tuple[Definition, ...] = (
    ("bench.scenario.scenario", "Scenario"),
    ("bench.scoring.combination", "combine_with_prior"),
    ("bench.scoring.score", "score"),
)
"""What the rows of every cell pass through, whatever the method: data and scores."""
SUMMARY: Definition = ("bench.scoring.summary", "summarise")
BOUND: Definition = ("bench.information.fisher", "compute_bound")


@dataclass(frozen=True)
class Version:
    """What computes a cell.

    ``digest`` is that of all definitions in use and of the packages, wherever the definitions stand: of those that make
    the rows, a dash, of those that summarise them beside the bound. ``modules`` has a digest of those that each module
    holds, and serves to say where a change is; ``packages`` their public versions.
    """

    digest: str
    modules: Mapping[str, str]
    packages: Mapping[str, str]

    def as_json(self) -> dict[str, Any]:
        return {"digest": self.digest, "modules": dict(self.modules), "packages": dict(self.packages)}

    @property
    def of_rows(self) -> str:
        """The part of the digest that the rows hang on; what has the same needs no fit to be brought up to date."""
        return rows_digest(self.digest)

    def changes(self, stored: Mapping[str, Any]) -> list[str]:
        """What differs from a stored version, in words; nothing where nothing does."""
        modules, packages = stored.get("modules", {}), stored.get("packages", {})
        names = sorted({*modules, *self.modules})
        parts = [f"{name} changed" for name in names if modules.get(name) != self.modules.get(name)]
        for name in sorted({*packages, *self.packages}):
            old, new = packages.get(name), self.packages.get(name)
            if old != new:
                parts.append(f"{name} {old or 'absent'}, now {new or 'absent'}")
        return parts

    def changed_since(self, stored: Mapping[str, Any]) -> str:
        """The same in one line."""
        return ", ".join(self.changes(stored))


def rows_digest(digest: str) -> str:
    """The part of a digest that the rows of a cell hang on."""
    return digest.partition("-")[0]


@cache
def cell_version(method: str, system: str, disturbance: str = "none") -> Version:
    """The version of what computes the cells of a method, or of a reference row, on a system with a disturbance."""
    roots = list(SCORING)
    if method in REFERENCES:
        roots.append((REFERENCES[method].__module__, REFERENCES[method].__name__))
    points = registry.registered().get(method), registered_systems().get(system)
    roots += [(point.module, point.attr) for point in points if point]
    disturbing = kinds().get(disturbance)
    if disturbing is not None:
        roots.append((disturbing.__module__, disturbing.__name__))
    rows, summary = version_of(roots), _summary_version(system)
    own = {name: digest for name, digest in summary.modules.items() if rows.modules.get(name) != digest}
    modules = {**rows.modules, **{f"{name} (summary)": digest for name, digest in own.items()}}
    return Version(f"{rows.digest}-{summary.digest}", modules, rows.packages)


@cache
def _summary_version(system: str) -> Version:
    point = registered_systems().get(system)
    return version_of([SUMMARY, BOUND, *([(point.module, point.attr)] if point else [])])


@cache
def bound_version(system: Definition) -> str:
    """The digest of what computes the bounds of a system, which is named by its class."""
    return version_of([BOUND, system]).digest


def version_of(roots: Iterable[Definition]) -> Version:
    """The version of some definitions and of all that they use."""
    roots = tuple(roots)
    found = uses(roots, {HARNESS, *(module.partition(".")[0] for module, _ in roots)})
    by_module: dict[str, list[str]] = defaultdict(list)
    for (module, name), digest in found.definitions.items():
        by_module[module].append(f"{name} {digest}")
    packages = {name: public for name in sorted(found.packages) if (public := _public_version(name))}
    return Version(
        _digest([sorted(set(found.definitions.values())), packages]),
        {module: _digest(sorted(lines))[:12] for module, lines in sorted(by_module.items())},
        packages,
    )


def _digest(content: Any) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]


@cache
def _public_version(package: str) -> str | None:
    """The version of a package without its build's suffix; None for the standard library and the absent."""
    if package in sys.stdlib_module_names:
        return None
    try:
        found = version(package)
    except PackageNotFoundError:
        distributions = packages_distributions().get(package)
        if not distributions:
            return None
        found = version(distributions[0])
    return found.partition("+")[0]
