"""Check the imports of a method: only public names of ``bench`` are part of the contract."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Sequence
from functools import cache
from importlib import import_module
from pathlib import Path

from bench.conformance.check import Refusal

HARNESS = "bench"
MODULE = re.compile(r"bench(\.\w+)+")
"""Name of a module of the harness as a string, for dynamic imports."""


@cache
def foreign_imports(path: Path, allowed: Sequence[str] = (HARNESS,)) -> tuple[str, ...]:
    """List the imports of a file that are not public names of the ``allowed`` modules of the harness."""
    names = import_module(HARNESS).__all__
    lines = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        modules: list[tuple[str, str]] = []
        if isinstance(node, ast.Import):
            modules = [(alias.name, "") for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            modules = [(node.module or "", alias.name) for alias in node.names]
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and MODULE.fullmatch(node.value):
            modules = [(node.value, "")]
        for module, name in modules:
            public = module in allowed and (module != HARNESS or not name or name in names)
            if module.partition(".")[0] == HARNESS and not public:
                what = f"{module}.{name}" if name else module
                lines.append(f"{path.name}, line {getattr(node, 'lineno', 0)}, uses {what}")
    return tuple(lines)


def check_imports(cls: type, allowed: Sequence[str] = (HARNESS,)) -> None:
    """Raise Refusal if the package of a class (without tests), or its module, imports other names of the harness."""
    root = sys.modules[cls.__module__.partition(".")[0]]
    paths = [Path(str(sys.modules[cls.__module__].__file__))]
    if root.__file__ is not None and hasattr(root, "__path__"):
        folder = Path(root.__file__).parent
        paths = [path for path in sorted(folder.rglob("*.py")) if "tests" not in path.relative_to(folder).parts]
    lines = [line for path in paths for line in foreign_imports(path, allowed)]
    if lines:
        raise Refusal("; ".join(lines[:3]))
