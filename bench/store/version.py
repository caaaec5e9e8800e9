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
    ("bench.scoring.summary", "summarise"),
    ("bench.information.fisher", "compute_bound"),
)
"""What every cell's numbers pass through, whatever the method: data, scores, summaries, bounds."""


@dataclass(frozen=True)
class Version:
    """What computes a cell.

    ``digest`` is that of all definitions in use and of the packages, wherever the definitions stand; ``modules`` has a
    digest of those that each module holds, and serves to say where a change is; ``packages`` their public versions.
    """

    digest: str
    modules: Mapping[str, str]
    packages: Mapping[str, str]

    def as_json(self) -> dict[str, Any]:
        return {"digest": self.digest, "modules": dict(self.modules), "packages": dict(self.packages)}

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
    return version_of(roots)


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
