"""Rules of the house, read off the source: who may import whom, and that what is public is documented."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import pytest
from conftest import REPOSITORY

from bench.conformance.imports import foreign_imports

HEAVY = {"torch", "casadi", "pysindy", "emcee", "blackjax"}
ROOMS = (
    "errors", "entry_points", "files", "isolation", "systems", "contract", "dynamics", "scenario", "likelihood",
    "entrants", "information", "scoring", "audit", "store", "modal", "online", "atlas", "config", "engine",
    "conformance", "records", "rounds", "exchange", "planning", "reporting", "face", "twin", "commands",
)  # fmt: skip
"""From the top of the house down: a module imports from its own room and from those above."""
BENCH = sorted((REPOSITORY / "bench").rglob("*.py"))
METHODS = sorted((REPOSITORY / "methods").rglob("*.py"))


@cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def offenders(paths: list[Path], offence: Callable[[Path], object]) -> dict[str, object]:
    """Return what is wrong with each file with which anything is, by name."""
    return {str(path.relative_to(REPOSITORY)): wrong for path in paths if (wrong := offence(path))}


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


def roots(items: Iterator[tuple[str, str]]) -> set[str]:
    """Return the packages of imports."""
    return {module.partition(".")[0] for module, _ in items}


def test_the_harness_knows_no_method_and_no_package_of_a_method() -> None:
    assert offenders(BENCH, lambda path: roots(imports(parsed(path))) & (HEAVY | {"methods"})) == {}


def test_a_method_imports_only_public_names_of_the_contract() -> None:
    assert offenders(METHODS, foreign_imports) == {}


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
    for module, imported in imports(parsed(path)):
        if module.partition(".")[0] == "bench" and not imported.startswith("__"):
            below = REPOSITORY.joinpath(*module.split("."), imported)
            inside = below.with_suffix(".py").is_file() or (below / "__init__.py").is_file()
            found.add(f"{module}.{imported}" if inside else module)
    return found


def room(module: str) -> str:
    """The room of a module: ``bench.scenario.truth`` is in ``scenario``."""
    return module.split(".")[1]


def test_imports_go_one_way_through_the_rooms() -> None:
    def from_below(path: Path) -> set[str]:
        place = ROOMS.index(path.relative_to(REPOSITORY).parts[1])
        return {name for name in imported_modules(path) if name == "bench" or ROOMS.index(room(name)) > place}

    assert offenders([path for path in BENCH if path.parent.name != "bench"], from_below) == {}


def test_contributing_lists_the_subpackages_in_their_order() -> None:
    text = (REPOSITORY / "CONTRIBUTING.md").read_text(encoding="utf-8")
    assert tuple(re.findall(r"^\| `(\w+)` \|", text, re.M)) == ROOMS


def test_no_modules_import_each_other_in_a_circle() -> None:
    """Of harness and methods alike, imports inside functions included."""
    paths = {".".join(p.relative_to(REPOSITORY).with_suffix("").parts): p for p in [*BENCH, *METHODS]}
    arrows = {}
    for module, path in paths.items():
        found = set()
        for origin, imported in imports(parsed(path)):
            found |= {origin, f"{origin}.{imported}"} & (paths.keys() - {"bench"})
        arrows[module] = found
    while leaves := [module for module, to in arrows.items() if not to & (arrows.keys() - {module})]:
        for module in leaves:
            del arrows[module]
    assert not arrows


def test_jax_is_imported_in_functions_only() -> None:
    def early(path: Path) -> set[str]:
        return {"jax"} & {package for item in at_import_time(parsed(path)) for package in roots(imports(item))}

    assert offenders(BENCH, early) == {}


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


def test_what_is_public_has_a_docstring() -> None:
    """The module, and its public functions and classes."""

    def undocumented(path: Path) -> list[str]:
        items = [item for item in parsed(path).body if isinstance(item, ast.FunctionDef | ast.ClassDef)]
        names = [item.name for item in items if item.name[0] != "_" and not ast.get_docstring(item)]
        return names if ast.get_docstring(parsed(path)) else ["the module", *names]

    assert offenders(BENCH + METHODS, undocumented) == {}


def test_no_file_names_a_place_on_somebodys_machine() -> None:
    for path in [*BENCH, *METHODS, *(REPOSITORY / "conf").rglob("*.yaml")]:
        text = path.read_text(encoding="utf-8")
        for place in ("/home/", "/root/", "/Users/", "/work/"):
            assert place not in text, path


def test_a_class_name_stands_once() -> None:
    """A reader who meets a class by its name alone must find one; names inside functions and classes apart."""
    places: dict[str, list[str]] = {}
    for path in BENCH + METHODS:
        for item in parsed(path).body:
            if isinstance(item, ast.ClassDef):
                places.setdefault(item.name, []).append(str(path.relative_to(REPOSITORY)))
    repeated = {name: paths for name, paths in places.items() if len(paths) > 1}
    assert repeated == {}
