"""What computes a cell: the source that a method's module imports from here, and the versions of its packages.

Read off the source without importing anything: a module's imports, and theirs, as far as they lead within the method's
own distribution and the harness. Comments, docstrings and layout do not count. Two versions that differ name the
modules and packages in which they do.
"""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import json
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from pathlib import Path
from typing import Any

from bench.entrants import registry
from bench.entrants.reference import REFERENCES
from bench.systems import registered_systems

HARNESS = "bench"
SCORING = (
    "bench.scenario.scenario",
    "bench.scoring.combination",
    "bench.scoring.score",
    "bench.scoring.summary",
    "bench.information.fisher",
)
"""What every cell's numbers pass through, whatever the method: data, scores, summaries, bounds."""


@dataclass(frozen=True)
class Version:
    """Digests of the normalised source by module, and public versions by package."""

    modules: Mapping[str, str]
    packages: Mapping[str, str]

    @cached_property
    def digest(self) -> str:
        text = json.dumps([dict(self.modules), dict(self.packages)], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

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
def cell_version(method: str, system: str) -> Version:
    """The version of what computes the cells of a method, or of a reference row, on a system."""
    point = None if method in REFERENCES else registry.registered().get(method)
    own = ("bench.entrants.reference",) if point is None else (point.module,)
    physics = registered_systems().get(system)
    return version_of((*own, *SCORING, *((physics.module,) if physics else ())))


def version_of(modules: Iterable[str]) -> Version:
    """The version of some modules and of all that they import."""
    digests: dict[str, str] = {}
    packages: set[str] = set()
    wanted = list(modules)
    inside = {HARNESS, *(module.partition(".")[0] for module in wanted)}
    while wanted:
        module = wanted.pop()
        source = None if module in digests else _source(module)
        if source is None:
            continue
        digests[module], imported = _read(source)
        parents = [module.rsplit(".", n)[0] for n in range(1, module.count(".") + 1)]
        for name in (*parents, *imported):
            if name.partition(".")[0] in inside:
                wanted.append(name)
            else:
                packages.add(name.partition(".")[0])
    found = {name: public for name in packages if (public := _public_version(name))}
    return Version(dict(sorted(digests.items())), dict(sorted(found.items())))


@cache
def _source(module: str) -> Path | None:
    """The file of a module of this kind of distribution, or None: a name imported from a module is none."""
    top, _, rest = module.partition(".")
    try:
        spec = importlib.util.find_spec(top)
    except (ImportError, ValueError):
        return None
    if spec is None or spec.origin is None:
        return None
    origin = Path(spec.origin)
    if not rest:
        return origin
    path = origin.parent.joinpath(*rest.split("."))
    candidates = (path.with_suffix(".py"), path / "__init__.py")
    return next((c for c in candidates if c.is_file()), None) if origin.name == "__init__.py" else None


@cache
def _read(path: Path) -> tuple[str, tuple[str, ...]]:
    """Digest of a module's source without comments and docstrings, and the names that it imports."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    imported = tuple(_imports(tree))
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            kept = [item for item in node.body if not _is_text(item)]
            node.body = kept or [ast.Pass()]
    return hashlib.sha256(ast.unparse(tree).encode()).hexdigest()[:12], imported


def _is_text(node: ast.stmt) -> bool:
    """A docstring, or a string that documents the line above it."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _imports(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            yield node.module
            own = _rebound(node.module)
            yield from (f"{node.module}.{alias.name}" for alias in node.names if alias.name not in own)


@cache
def _rebound(package: str) -> frozenset[str]:
    """Names that a package imports from elsewhere: they hide modules of its own so called
    (``bench.commands.report``)."""
    path = _source(package)
    if path is None or path.name != "__init__.py":
        return frozenset()
    found = ast.parse(path.read_text(encoding="utf-8")).body
    imports = [node for node in found if isinstance(node, ast.ImportFrom) and node.module != package]
    return frozenset(alias.asname or alias.name for node in imports for alias in node.names)


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
