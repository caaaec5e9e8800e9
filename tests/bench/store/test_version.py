"""What computes a cell: everything its method's module imports from here, its packages, and nothing else."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from bench.store import version
from bench.store.version import Version, cell_version, version_of

SOURCES = {
    "pkg/__init__.py": "",
    "pkg/one.py": "import json\nimport numpy\nfrom pkg import shared\n\ndef f():\n    from pkg.lazy import g\n",
    "pkg/two.py": "from pkg.other import x\n",
    "pkg/shared.py": "VALUE = 1  # a comment\n",
    "pkg/lazy.py": "def g():\n    '''Says what.'''\n    return 1\n",
    "pkg/other.py": "x = 1\n",
}


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name, text in SOURCES.items():
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path / "pkg"


def forget() -> None:
    for cached in (version._source, version._read, cell_version):
        cached.cache_clear()


def changed(path: Path, text: str, module: str) -> str:
    """What is said to have changed in a module's version when a file is rewritten."""
    forget()
    before = version_of([module])
    path.write_text(text)
    forget()
    return version_of([module]).changed_since(before.as_json())


def test_the_closure_is_what_is_imported_from_here_and_lazily_too(package: Path) -> None:
    forget()
    found = version_of(["pkg.one"])
    assert set(found.modules) == {"pkg", "pkg.one", "pkg.shared", "pkg.lazy"}
    assert set(found.packages) == {"numpy"}, "neither the standard library nor what is not imported"
    assert "pkg.one" not in sys.modules, "nothing is imported to find out"


def test_a_change_is_seen_by_those_that_import_it_and_named(package: Path) -> None:
    assert changed(package / "lazy.py", "def g():\n    return 2\n", "pkg.one") == "pkg.lazy changed"
    assert changed(package / "other.py", "x = 2\n", "pkg.one") == ""
    assert changed(package / "other.py", "x = 3\n", "pkg.two") == "pkg.other changed"


def test_comments_docstrings_and_layout_do_not_count(package: Path) -> None:
    assert changed(package / "shared.py", "\n\nVALUE = (1)\n", "pkg.one") == ""
    assert changed(package / "lazy.py", "# new\ndef g():\n\n    return 1\n", "pkg.one") == ""
    assert changed(package / "shared.py", "VALUE = 1.0\n", "pkg.one") == "pkg.shared changed"


def test_packages_are_compared_by_their_public_version() -> None:
    now = Version({"a": "1"}, {"numpy": "2.4.6", "torch": "2.13.0"})
    assert now.changed_since(now.as_json()) == ""
    stored = {"modules": {"a": "1"}, "packages": {"numpy": "2.3.0", "casadi": "3.7"}}
    assert now.changed_since(stored) == "casadi 3.7, now absent, numpy 2.3.0, now 2.4.6, torch absent, now 2.13.0"
    found = version_of(["methods.pinn"]).packages
    assert not any("+" in public for public in found.values())
    assert {"torch", "numpy", "scipy"} <= set(found)


def test_a_method_hangs_on_its_own_code_and_the_systems_not_on_other_methods_or_the_command_line() -> None:
    forget()
    shooting, pinn = cell_version("shooting", "sdof"), cell_version("pinn", "sdof")
    assert "methods.trajectory.shooting" in shooting.modules
    assert not any(name.startswith("methods.pinn") for name in shooting.modules)
    assert "methods.trajectory.shooting" not in pinn.modules
    for module in (
        "bench.scoring.score",
        "bench.scenario.scenario",
        "bench.dynamics.simulate",
        "bench.information.fisher",
        "bench.systems.linear",
    ):
        assert module in shooting.modules
    for module in (
        "bench.commands.main",
        "bench.sweep.runner",
        "bench.store.store",
        "bench.sweep.scoring_process",
        "bench.reporting.frame",
        "bench.systems.nonlinear",
    ):
        assert module not in shooting.modules
    assert "bench.systems.nonlinear" in cell_version("shooting", "duffing").modules
    assert "bench.entrants.reference" in cell_version("oracle", "sdof").modules
    assert len({shooting.digest, pinn.digest, cell_version("shooting", "duffing").digest}) == 3
