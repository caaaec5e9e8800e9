"""What computes a cell: everything its method's module imports from here, its packages, and nothing else."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from bench.store import source
from bench.store.version import Version, cell_version, version_of

SOURCES = {
    "pkg/__init__.py": "from pkg.shared import VALUE\n",
    "pkg/one.py": (
        "import json\nimport numpy as np\nfrom pkg import VALUE, two\n\n"
        "def f(x: int) -> int:\n    from pkg.lazy import g\n    if x < 0:\n        raise ValueError(f'not {x}')\n"
        "    return np.abs(VALUE + g() + two.h())\n\n"
        "def unused():\n    return 1\n"
    ),
    "pkg/two.py": "from pkg.other import x\n\ndef h():\n    return 1\n\ndef k():\n    return x\n",
    "pkg/shared.py": "VALUE = 1  # a comment\nUNUSED = 2\n",
    "pkg/lazy.py": "def g():\n    '''Says what.'''\n    return 1\n",
    "pkg/other.py": "x = 1\n",
    "pkg/patched.py": "from pkg.shared import VALUE\n\ndef f():\n    return 1\n\nprint(VALUE)\n",
}


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name, text in SOURCES.items():
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    forget()
    return tmp_path / "pkg"


def forget() -> None:
    for cached in (source.source_file, source._top_level, source._read, source._reached, cell_version):
        cached.cache_clear()


def changed(path: Path, text: str, module: str, name: str) -> str:
    """What is said to have changed in a definition's version when a file is rewritten."""
    forget()
    before = version_of([(module, name)])
    path.write_text(text)
    forget()
    now = version_of([(module, name)])
    said = now.changed_since(before.as_json())
    assert bool(said) == (now.digest != before.digest)
    return said


def test_the_closure_is_what_a_definition_mentions_wherever_it_is_imported_from(package: Path) -> None:
    found = source.uses([("pkg.one", "f")], {"pkg"})
    assert set(found.definitions) == {("pkg.one", "f"), ("pkg.shared", "VALUE"), ("pkg.lazy", "g"), ("pkg.two", "h")}
    assert found.packages == {"numpy"}, "not what the module imports and the definition does not use"
    assert "pkg.one" not in sys.modules, "nothing is imported to find out"


def test_what_a_module_does_when_it_is_imported_belongs_to_each_of_its_definitions(package: Path) -> None:
    found = set(source.uses([("pkg.patched", "f")], {"pkg"}).definitions)
    assert found == {("pkg.patched", "f"), ("pkg.patched", source.EFFECTS), ("pkg.shared", "VALUE")}


def test_a_change_is_seen_by_what_uses_it_and_named(package: Path) -> None:
    assert changed(package / "lazy.py", "def g():\n    return 2\n", "pkg.one", "f") == "pkg.lazy changed"
    assert changed(package / "other.py", "x = 2\n", "pkg.one", "f") == "", "k uses it, f does not use k"
    assert changed(package / "other.py", "x = 3\n", "pkg.two", "k") == "pkg.other changed"
    assert changed(package / "shared.py", "VALUE = 1\nUNUSED = 3\n", "pkg.one", "f") == ""


def test_comments_docstrings_layout_types_and_sentences_of_errors_do_not_count(package: Path) -> None:
    assert changed(package / "shared.py", "\n\nVALUE = (1)\n", "pkg.one", "f") == ""
    assert changed(package / "lazy.py", "# new\ndef g() -> int:\n\n    return 1\n", "pkg.one", "f") == ""
    text = SOURCES["pkg/one.py"]
    assert changed(package / "one.py", text.replace("not {x}", "{x} is negative"), "pkg.one", "f") == ""
    assert changed(package / "one.py", text.replace("ValueError", "TypeError"), "pkg.one", "f") == "pkg.one changed"
    assert changed(package / "shared.py", "VALUE = 1.0\n", "pkg.one", "f") == "pkg.shared changed"


def test_the_card_of_a_method_does_not_count(package: Path) -> None:
    """What is said of a method, or the colour of its line, changes no number."""
    method = "from pkg.shared import VALUE, UNUSED\n\nclass M:\n    card: ClassVar[Card] = Card({})\n    step = {}\n"
    (package / "method.py").write_text(method.format("'grey'", "VALUE"))
    assert changed(package / "method.py", method.format("'red', UNUSED", "VALUE"), "pkg.method", "M") == ""
    assert changed(package / "method.py", method.format("'red'", "UNUSED"), "pkg.method", "M") != ""


def test_a_definition_that_moves_to_another_file_is_still_the_same(package: Path) -> None:
    before = version_of([("pkg.one", "f")])
    (package / "moved.py").write_text(SOURCES["pkg/shared.py"])
    (package / "__init__.py").write_text("from pkg.moved import VALUE\n")
    forget()
    assert version_of([("pkg.one", "f")]).digest == before.digest


def test_packages_are_compared_by_their_public_version() -> None:
    now = Version("", {"a": "1"}, {"numpy": "2.4.6", "torch": "2.13.0"})
    assert now.changed_since(now.as_json()) == ""
    stored = {"modules": {"a": "1"}, "packages": {"numpy": "2.3.0", "casadi": "3.7"}}
    assert now.changed_since(stored) == "casadi 3.7, now absent, numpy 2.3.0, now 2.4.6, torch absent, now 2.13.0"
    found = version_of([("methods.pinn", "PINN")]).packages
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
        "bench.information.fisher (summary)",
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


def test_a_disturbance_hangs_on_its_own_kind_alone() -> None:
    forget()
    roots = [("bench.scenario.disturbance", name) for name in ("Jitter", "Bias")]
    jitter, bias = (set(source.uses([root], {"bench"}).definitions) for root in roots)
    assert roots[0] in jitter
    assert roots[1] not in jitter
    assert len({cell_version("ls", "sdof", kind).digest for kind in ("none", "jitter", "bias")}) == 3
    assert len(jitter & bias) > 1
