"""Which definitions a piece of code uses, read off the source: what a stored number hangs on.

Starting from some names (a method's class, the functions of the scoring), every top-level definition that they mention
is followed, and what those mention in turn, through the modules of their own distribution and the harness. Nothing is
imported to find out. A definition counts by its text alone, without comments, docstrings, layout, annotations of
functions, the sentences of what it raises, the card of a method, and imports from here: so one that moves to another
file is still the same.
"""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import json
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

Definition = tuple[str, str]
"""A module and a name at its top level; an empty name stands for the whole module."""
EFFECTS = "(statements)"
"""The name of what a module does when it is imported, beside binding names."""
LAYOUT = frozenset({"ctx", "kind", "type_comment", "returns", "annotation"})
"""Fields of a syntax tree that change no number; the annotations of a class body are kept."""
CARD = "card"
"""The class variable that describes a method to readers (``bench.contract.method.Card``)."""
IMPORTS = (ast.ImportFrom, ast.Import)


@dataclass(frozen=True)
class Uses:
    """Digests of the definitions that are used, by module and name, and the top-level packages they import."""

    definitions: Mapping[Definition, str]
    packages: frozenset[str]


def digest_of(roots: Sequence[Definition]) -> str:
    """One digest of all definitions that some names use, in the harness and in the names' own packages."""
    inside = {"bench", *(module.partition(".")[0] for module, _ in roots)}
    text = json.dumps([[*name, digest] for name, digest in uses(roots, inside).definitions.items()])
    return hashlib.sha256(text.encode()).hexdigest()


def uses(roots: Iterable[Definition], inside: Collection[str]) -> Uses:
    """Find the definitions that some names use, themselves included.

    Args:
        roots: Where to begin.
        inside: Top-level packages whose source is followed; any other import counts as a package.
    """
    tops = frozenset(inside)
    found = [_reached(root, tops) for root in roots]
    digests = {definition: digest for one in found for definition, digest in one.definitions.items()}
    return Uses(dict(sorted(digests.items())), frozenset(package for one in found for package in one.packages))


@cache
def _reached(root: Definition, inside: frozenset[str]) -> Uses:
    """The same from one name: many begin with the same ones."""
    waiting = _resolved(*root, inside)
    digests: dict[Definition, str] = {}
    packages: set[str] = set()
    while waiting:
        module, name = waiting.pop()
        if module.partition(".")[0] not in inside:
            packages.add(module.partition(".")[0])
        elif (module, name) not in digests:
            digests[module, name], mentioned = _read(module, name, inside)
            waiting += mentioned
    return Uses(digests, frozenset(packages))


@dataclass
class _Text:
    """A statement as text that does not depend on layout, place or Python's version, and what it mentions."""

    inside: frozenset[str]
    parts: list[str] = field(default_factory=list)
    names: set[str] = field(default_factory=set)
    attributes: set[tuple[str, str]] = field(default_factory=set)
    imported: dict[str, Definition] = field(default_factory=dict)

    def add(self, node: object, silent: bool = False) -> None:
        """Append a node; ``silent`` where its sentences do not count."""
        if isinstance(node, ast.AST):
            if isinstance(node, IMPORTS) and self._import(node):
                return
            if silent and _is_sentence(node):
                self.parts.append("''")
            else:
                self._node(node, silent)
        elif isinstance(node, list):
            self.parts.append("[")
            for item in node:
                if not _is_text(item) and not _is_card(item):
                    self.add(item, silent)
            self.parts.append("]")
        else:
            self.parts.append(repr(node))

    def _node(self, node: ast.AST, silent: bool) -> None:
        if isinstance(node, ast.Name):
            self.names.add(node.id)
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            self.attributes.add((node.value.id, node.attr))
            self.parts.append(f"{node.value.id}.{node.attr}")
            return
        self.parts.append(type(node).__name__ + "(")
        kept = isinstance(node, ast.AnnAssign)
        for name in node._fields:
            value = getattr(node, name, None)
            if value is not None and value != [] and (name not in LAYOUT or (kept and name == "annotation")):
                self.parts.append(f"{name}=")
                self.add(value, silent or isinstance(node, ast.Raise))
        self.parts.append(")")

    def _import(self, node: ast.Import | ast.ImportFrom) -> bool:
        """Note what an import binds; whether it is from here, and no part of the text."""
        bound = dict(_imports(node))
        self.imported.update(bound)
        return all(origin.partition(".")[0] in self.inside for origin, _ in bound.values())


@cache
def _read(module: str, name: str, inside: frozenset[str]) -> tuple[str, tuple[Definition, ...]]:
    """The digest of a definition, and what it mentions."""
    path = source_file(module)
    assert path is not None
    top = _top_level(path)
    text = _Text(inside)
    text.add(list(top.effects if name == EFFECTS else top.bound[name]))
    mentioned: list[Definition] = [(module, EFFECTS)] if top.effects and name != EFFECTS else []
    for origin, attribute in _mentioned(module, top, text):
        mentioned += _resolved(origin, attribute, inside)
    return hashlib.sha256("".join(text.parts).encode()).hexdigest()[:12], tuple(dict.fromkeys(mentioned))


def _mentioned(module: str, top: _Module, text: _Text) -> Iterator[Definition]:
    """What a definition mentions: names of its module and of other modules, and what it imports itself."""
    imported = {**top.imported, **text.imported}
    for name, attribute in text.attributes:
        if name in imported:
            origin, member = imported[name]
            whole = f"{origin}.{member}" if member else origin
            # an attribute of a module is a definition there; that of anything else says nothing
            yield (whole, attribute) if source_file(whole) else (origin, member)
        elif name in top.bound:
            yield module, name
    for name in text.names:
        if name in imported:
            yield imported[name]
        elif name in top.bound:
            yield module, name
    yield from (target for target in text.imported.values() if source_file(target[0]) is None)


def _resolved(module: str, name: str, inside: frozenset[str]) -> list[Definition]:
    """Where a name of a module is defined: there, where the module imports it from, or in a module so called."""
    if module.partition(".")[0] not in inside:
        return [(module, "")]
    path = source_file(module)
    if path is None:
        return []
    top = _top_level(path)
    if name in top.bound or (name == EFFECTS and top.effects):
        return [(module, name)]
    if name in top.imported:
        return _resolved(*top.imported[name], inside)
    if name:
        return _resolved(f"{module}.{name}", "", inside) if source_file(f"{module}.{name}") else []
    elsewhere = [found for bound in top.imported for found in _resolved(module, bound, inside)]
    return [*((module, bound) for bound in top.bound), *elsewhere]


@cache
def source_file(module: str) -> Path | None:
    """Return the file of a module of a package with source, or None; nothing is imported."""
    top, _, rest = module.partition(".")
    if top in sys.stdlib_module_names:
        return None
    try:
        spec = importlib.util.find_spec(top)
    except (ImportError, ValueError):
        return None
    if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
        return None
    origin = Path(spec.origin)
    if not rest:
        return origin
    path = origin.parent.joinpath(*rest.split("."))
    candidates = (path.with_suffix(".py"), path / "__init__.py")
    return next((c for c in candidates if c.is_file()), None) if origin.name == "__init__.py" else None


@dataclass(frozen=True)
class _Module:
    """The top level of a module: the statements that bind each name, what its imports bind, and other statements."""

    bound: Mapping[str, tuple[ast.stmt, ...]]
    imported: Mapping[str, Definition]
    effects: tuple[ast.stmt, ...]


@cache
def _top_level(path: Path) -> _Module:
    """The top level of a file."""
    bound: dict[str, tuple[ast.stmt, ...]] = {}
    imported: dict[str, Definition] = {}
    effects: list[ast.stmt] = []
    for statement in ast.parse(path.read_text(encoding="utf-8")).body:
        names = list(_names(statement))
        for name in names:
            bound[name] = (*bound.get(name, ()), statement)
        if isinstance(statement, ast.Import | ast.ImportFrom):
            imported.update(_imports(statement))
        elif not names and not _is_text(statement) and not _for_types(statement):
            effects.append(statement)
    return _Module(bound, imported, tuple(effects))


def _names(statement: ast.stmt) -> Iterator[str]:
    """The names that a top-level statement defines."""
    if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        yield statement.name
    targets = statement.targets if isinstance(statement, ast.Assign) else []
    if isinstance(statement, ast.AnnAssign | ast.AugAssign):
        targets = [statement.target]
    for target in targets:
        yield from (node.id for node in ast.walk(target) if isinstance(node, ast.Name))


def _imports(node: ast.Import | ast.ImportFrom) -> Iterator[tuple[str, Definition]]:
    """What an import binds: the name, and where it comes from."""
    if isinstance(node, ast.Import):
        for alias in node.names:
            yield alias.asname or alias.name.partition(".")[0], (alias.name, "")
    elif node.module and node.level == 0:
        yield from ((alias.asname or alias.name, (node.module, alias.name)) for alias in node.names)


def _is_text(node: object) -> bool:
    """Whether a statement is a docstring, or a string that documents the line above it."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _is_card(node: object) -> bool:
    """Whether a statement of a class body is its card, which describes a method and computes nothing."""
    return isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.target.id == CARD


def _is_sentence(node: object) -> bool:
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))


def _for_types(node: ast.stmt) -> bool:
    """Whether a statement is there for a type checker alone."""
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"
