"""Checks of the language: names of modules and variables, and sections of the docstrings of exported names."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import REPOSITORY

import bench

VAGUE = {"found", "own", "one", "at", "told", "tells", "untold", "held", "gone", "beside", "theirs", "ours", "said",
         "seen", "asked"}  # fmt: skip
"""Names that do not say what they hold."""
LONGEST_SPAN = 3
"""Lines over which such a name may be used: within a comprehension or two lines the context explains it."""
ADJECTIVES = {"apart", "differentiable", "drawn", "elsewhere", "fresh", "frozen", "gone", "grown", "held", "longer",
              "mainless", "of_hydra", "optimal", "rough", "separate", "strongest", "taken", "told", "untold",
              "wider"}  # fmt: skip
"""Module names that are no nouns, besides those in -ed; modal, online and nonlinear are terms of the field."""
PENDING = {
    "bench/online/course.py",  # fields of conf/online: at, told
    "bench/online/forces.py",
}
"""Rooms whose names are not checked yet."""
SOURCES = sorted(path for room in ("bench", "methods") for path in (REPOSITORY / room).rglob("*.py"))


def _place(path: Path) -> str:
    return path.relative_to(REPOSITORY).as_posix()


CHECKED = [path for path in SOURCES if not any((_place(path) + "/").startswith(room + "/") for room in PENDING)]


def vague_names(source: str) -> list[str]:
    """Return local names that are vague and used over many lines, and functions, attributes and fields that are."""
    tree, bad = ast.parse(source), set()
    for scope in ast.walk(tree):
        if isinstance(scope, ast.FunctionDef | ast.Lambda):
            uses: dict[str, list[int]] = {}
            for node in ast.walk(scope):
                name = getattr(node, "id", getattr(node, "arg", None))
                if isinstance(node, ast.Name | ast.arg) and name in VAGUE:
                    uses.setdefault(name, []).append(node.lineno)
            bad |= {f"{min(n)}: {name}" for name, n in uses.items() if max(n) - min(n) >= LONGEST_SPAN}
        if isinstance(scope, ast.FunctionDef | ast.ClassDef) and scope.name.strip("_") in VAGUE:
            bad.add(f"{scope.lineno}: {scope.name}")
        if isinstance(scope, ast.Attribute) and isinstance(scope.ctx, ast.Store) and scope.attr.strip("_") in VAGUE:
            bad.add(f"{scope.lineno}: .{scope.attr}")
        if isinstance(scope, ast.ClassDef):
            fields = [item.target for item in scope.body if isinstance(item, ast.AnnAssign)]
            bad |= {f"{f.lineno}: {f.id}" for f in fields if isinstance(f, ast.Name) and f.id in VAGUE}
    return sorted(bad, key=lambda text: int(text.split(":")[0]))


def test_names_say_what_they_hold() -> None:
    assert {_place(path): bad for path in CHECKED if (bad := vague_names(path.read_text(encoding="utf-8")))} == {}


def test_vague_names_are_recognised() -> None:
    source = "def f(at, x):\n    found = x\n    y = at\n    z = y\n    return found\nclass A:\n    own: int = 0\n"
    assert vague_names(source) == ["2: found", "7: own"]


def test_modules_are_nouns() -> None:
    def wrong(stem: str) -> bool:
        return stem in ADJECTIVES or (last := stem.rpartition("_")[2]) in ADJECTIVES or last.endswith("ed")

    assert [_place(path) for path in CHECKED if wrong(path.stem)] == []


def undocumented_function(name: str, function: Callable[..., object], document: str) -> list[str]:
    """Return what the docstring of a function or method lacks."""
    signature = inspect.signature(function)
    parameters = [p for p in signature.parameters if p not in ("self", "cls")]
    wanted = [] if document else ["a docstring"]
    if len(parameters) > 1:
        wanted += [f"{p}:" for p in parameters if f"{p}:" not in document] if "Args:" in document else ["Args:"]
        if signature.return_annotation not in (None, "None", "NoReturn") and not re.search(
            "(Return|Yield)s:", document
        ):
            wanted.append("Returns:")
        raised = re.findall(r"\n +raise (\w+)", inspect.getsource(function))
        if set(raised) - {"NotImplementedError"} and "Raises:" not in document:
            wanted.append("Raises:")
    return [f"{name}: {item}" for item in wanted]


def undocumented_class(name: str, cls: type) -> list[str]:
    """Return what the docstrings of a class, its fields and its methods lack."""
    lacking = [] if cls.__doc__ else [f"{name}: a docstring"]
    if dataclasses.is_dataclass(cls):
        described = re.findall(r'\n    (\w+): [^\n]*\n    """', inspect.getsource(cls))
        fields = [f.name for f in dataclasses.fields(cls) if f.name in vars(cls)["__annotations__"]]
        missing = [f for f in fields if f not in described and f"{f}:" not in (cls.__doc__ or "")]
        lacking += [f"{name}.{field}" for field in missing if len(fields) > 1]
    for attribute, value in vars(cls).items():
        function = getattr(value, "__func__", value)
        if inspect.isfunction(function) and not attribute.startswith("_"):
            document = inspect.getdoc(getattr(cls, attribute)) or ""
            lacking += undocumented_function(f"{name}.{attribute}", function, document)
    return lacking


def undocumented(name: str) -> list[str]:
    """Return what the documentation of an exported name lacks."""
    item = getattr(bench, name)
    if inspect.isfunction(item):
        return undocumented_function(name, item, inspect.getdoc(item) or "")
    return undocumented_class(name, item) if inspect.isclass(item) and item.__module__.startswith("bench") else []


@pytest.mark.parametrize("name", bench.__all__)
def test_exported_names_document_parameters_results_and_errors(name: str) -> None:
    place = getattr(getattr(bench, name), "__module__", "bench").replace(".", "/")
    if not any(f"{place}/".startswith(f"{room.removesuffix('.py')}/") for room in PENDING):
        assert undocumented(name) == []
