"""Rules of the house, read off the source: who may import whom, and that what is public is documented."""

from __future__ import annotations

import ast
import inspect
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from conftest import REPOSITORY

import bench
from bench.conformance.imports import foreign_imports

HEAVY = {"torch", "casadi", "pysindy", "emcee", "blackjax"}
ROOMS = (
    "errors", "files", "isolation", "systems", "contract", "dynamics", "scenario", "likelihood", "entrants",
    "information", "scoring", "store", "online", "atlas", "config", "engine", "conformance", "exchange",
    "measured", "planning", "reporting", "face", "twin", "commands",
)  # fmt: skip
"""From the top of the house down: a module imports from its own room and from those above."""
BENCH = sorted((REPOSITORY / "bench").rglob("*.py"))
METHODS = sorted((REPOSITORY / "methods").rglob("*.py"))


def name(path: Path) -> str:
    return str(path.relative_to(REPOSITORY))


def imports(node: ast.AST) -> Iterator[tuple[str, str]]:
    """(module, name) of every import below a node; the name is empty for a plain import."""
    for item in ast.walk(node):
        if isinstance(item, ast.Import):
            yield from ((alias.name, "") for alias in item.names)
        elif isinstance(item, ast.ImportFrom):
            assert item.level == 0, "imports are absolute"
            yield from ((item.module or "", alias.name) for alias in item.names)


def at_import_time(tree: ast.Module) -> Iterator[ast.stmt]:
    """The statements that run when a module is imported: all but those in functions and type-checking blocks."""
    queue: list[ast.stmt] = list(tree.body)
    while queue:
        item = queue.pop()
        if isinstance(item, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        if isinstance(item, ast.If) and "TYPE_CHECKING" in ast.dump(item.test):
            queue += item.orelse
            continue
        if isinstance(item, ast.Import | ast.ImportFrom):
            yield item
        queue += [child for child in ast.iter_child_nodes(item) if isinstance(child, ast.stmt)]


@pytest.mark.parametrize("path", BENCH, ids=name)
def test_the_harness_knows_no_method_and_no_package_of_a_method(path: Path) -> None:
    roots = {module.partition(".")[0] for module, _ in imports(ast.parse(path.read_text(encoding="utf-8")))}
    assert not roots & (HEAVY | {"methods"})


@pytest.mark.parametrize("path", METHODS, ids=name)
def test_a_method_imports_only_public_names_of_the_contract(path: Path) -> None:
    assert foreign_imports(path) == ()


def test_an_import_of_more_than_the_contract_is_seen_however_it_is_written(tmp_path: Path) -> None:
    path = tmp_path / "own.py"
    path.write_text(
        "import bench\nfrom bench import Estimate\nfrom bench.scenario.truth import Truth\nimport bench.store.store\n"
        "from bench import store\n__import__('bench.scenario')\nimport benchmarks\n'bench is a word'\n"
    )
    assert foreign_imports(path) == tuple(
        f"own.py, line {line}, uses {what}"
        for line, what in (
            (3, "bench.scenario.truth.Truth"),
            (4, "bench.store.store"),
            (5, "bench.store"),
            (6, "bench.scenario"),
        )
    )


def imported_modules(path: Path) -> set[str]:
    """The modules of the harness that a file imports, anywhere in it."""
    found = set()
    for module, imported in imports(ast.parse(path.read_text(encoding="utf-8"))):
        if module.partition(".")[0] == "bench" and not imported.startswith("__"):
            below = REPOSITORY.joinpath(*module.split("."), imported)
            inside = below.with_suffix(".py").is_file() or (below / "__init__.py").is_file()
            found.add(f"{module}.{imported}" if inside else module)
    return found


def room(module: str) -> str:
    """The room of a module: ``bench.scenario.truth`` is in ``scenario``."""
    return module.split(".")[1]


@pytest.mark.parametrize("path", [p for p in BENCH if p.parent.name != "bench"], ids=name)
def test_imports_go_one_way_through_the_rooms(path: Path) -> None:
    own = ROOMS.index(room(".".join(path.relative_to(REPOSITORY).parts)))
    below = {module for module in imported_modules(path) if module == "bench" or ROOMS.index(room(module)) > own}
    assert not below


def test_no_modules_import_each_other_in_a_circle() -> None:
    """Of harness and methods alike, imports inside functions included."""
    paths = {".".join(p.relative_to(REPOSITORY).with_suffix("").parts): p for p in [*BENCH, *METHODS]}
    arrows = {}
    for module, path in paths.items():
        found = set()
        for origin, imported in imports(ast.parse(path.read_text(encoding="utf-8"))):
            found |= {origin, f"{origin}.{imported}"} & (paths.keys() - {"bench"})
        arrows[module] = found
    while leaves := [module for module, to in arrows.items() if not to & (arrows.keys() - {module})]:
        for module in leaves:
            del arrows[module]
    assert not arrows


@pytest.mark.parametrize("path", BENCH, ids=name)
def test_jax_is_imported_in_functions_only(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    roots = {module.partition(".")[0] for item in at_import_time(tree) for module, _ in imports(item)}
    assert "jax" not in roots


def test_registered_classes_load_no_heavy_package() -> None:
    """What an entry point names is imported by every command line; here, all of them in a fresh process."""
    script = (
        "import sys\n"
        "from bench.errors import InputError\n"
        "from bench.entrants.registry import load_method, registered\n"
        "for name in registered():\n"
        "    load_method(name)\n"
        f"print(sorted(set(sys.modules) & {HEAVY | {'scipy.stats'}!r}))\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=REPOSITORY)
    assert done.stdout == "[]\n", done.stderr


@pytest.mark.parametrize("argument", ["--help", "method=no_such_method"])
def test_help_and_a_wrong_name_load_no_numerical_library(argument: str) -> None:
    """Beyond numpy, which the contract itself is made of."""
    script = (
        "import sys\n"
        "from bench.commands.main import main\n"
        f"main([{argument!r}])\n"
        "print(sorted({'scipy', 'pandas', 'pyarrow', 'jax'} & set(sys.modules)))\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=REPOSITORY)
    assert done.stdout.splitlines()[-1] == "[]", done.stderr


@pytest.mark.parametrize("path", BENCH + METHODS, ids=name)
def test_what_is_public_has_a_docstring(path: Path) -> None:
    """The module, and its public functions and classes."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    assert ast.get_docstring(tree), "the module"
    public = [item for item in tree.body if isinstance(item, ast.FunctionDef | ast.ClassDef) and item.name[0] != "_"]
    assert [item.name for item in public if not ast.get_docstring(item)] == []


@pytest.mark.parametrize("exported", bench.__all__)
def test_the_public_face_is_documented(exported: str) -> None:
    """Every function and class of the contract, and every public function of its classes, theirs or a base's."""
    item = getattr(bench, exported)
    if inspect.isclass(item) and item.__module__.startswith("bench"):
        assert item.__doc__
        for attribute, value in vars(item).items():
            if inspect.isfunction(value) and not attribute.startswith("_"):
                assert inspect.getdoc(getattr(item, attribute)), f"{exported}.{attribute}"
    elif callable(item) and inspect.isfunction(item):
        assert item.__doc__


def test_no_file_names_a_place_on_somebodys_machine() -> None:
    for path in [*BENCH, *METHODS, *(REPOSITORY / "conf").rglob("*.yaml")]:
        text = path.read_text(encoding="utf-8")
        for place in ("/home/", "/root/", "/Users/", "/work/"):
            assert place not in text, name(path)
