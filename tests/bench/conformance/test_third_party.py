"""A good, a sloppy and a dishonest method of somebody else: passed, refused with a remedy, caught."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
from conftest import Python

from bench import Identifier
from bench.commands.main import main as bench_main
from bench.conformance.candidate import Candidate
from bench.conformance.check import Outcome, outcome
from bench.conformance.method_checks import METHOD_CHECKS

FOLDER = Path(__file__).parent / "third_party"
FAULTS = {
    "changes_the_input": "input",
    "global_stream": "seed",
    "no_seed": "seed",
    "counts_calls": "state",
    "starts_from_the_last": "state",
    "looks_at_its_neighbours": "company",
    "metres_only": "units, mm",
    "seconds_only": "units, tenths of a second",
    "raises_on_few": "five samples",
    "nan_on_few": "five samples",
    "says_nothing": "five samples",
    "lambda": "pickling",
    "states_a_mass": "no prior",
    "misshapen": "answer",
    "foreign_names": "answer",
    "goes_on": "time",
}
"""What is wrong with a method, and the check that must see it."""
WAYS = ("attribute", "frames", "inspect", "traceback", "gc", "store", "variable", "main_file", "scenario_files")


@pytest.fixture
def third_party(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, ModuleType]]:
    """Their modules, as whoever has them on the path imports them."""
    monkeypatch.syspath_prepend(str(FOLDER))
    names = ("good", "sloppy", "dishonest")
    yield {name: __import__(name) for name in names}
    for name in names:
        sys.modules.pop(name, None)


def failures(method: Identifier) -> dict[str, Outcome]:
    candidate = Candidate(method)
    found = [outcome(check, candidate) for check in METHOD_CHECKS]
    return {one.name: one for one in found if not one.passed}


def test_a_good_method_passes_every_check(third_party: dict[str, ModuleType]) -> None:
    assert failures(third_party["good"].Good()) == {}
    assert failures(third_party["sloppy"].Sloppy()) == {}
    assert failures(third_party["dishonest"].Dishonest(way="none")) == {}


@pytest.mark.filterwarnings("ignore:a warning with its place")
def test_who_logs_and_warns_is_not_taken_for_one_who_looks_at_frames(third_party: dict[str, ModuleType]) -> None:
    assert failures(third_party["sloppy"].Sloppy(fault="only_talks")) == {}


def test_who_sends_the_problem_to_another_process_is_not_taken_for_a_spy(third_party: dict[str, ModuleType]) -> None:
    assert failures(third_party["sloppy"].Sloppy(fault="only_copies")) == {}


def test_an_installed_package_is_known_by_its_name(tmp_path: Path, python: Python) -> None:
    """As ``pip install`` leaves it: by the name of the distribution, of its module and of the method alike."""
    (tmp_path / "good.py").write_text((FOLDER / "good.py").read_text())
    info = tmp_path / "somebodys_methods-2.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: Somebodys_Methods\nVersion: 2.0\n")
    (info / "entry_points.txt").write_text("[bench.methods]\nother_name = good:Good\n")
    path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    for name in ("somebodys-methods", "good", "other_name"):
        done = python("-m", "bench", "check", f"package={name}", env={"PYTHONPATH": path})
        assert done.returncode == 0, done.stdout + done.stderr
        assert done.stdout.startswith("method other_name (good:Good)\n")


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_seen_by_its_check_and_has_a_remedy(fault: str, third_party: dict[str, ModuleType]) -> None:
    found = failures(third_party["sloppy"].Sloppy(fault=fault))
    assert FAULTS[fault] in found, found
    for one in found.values():
        assert len(one.found.split()) >= 3
        assert len(one.remedy.split()) >= 4
        assert "\n" not in one.found + one.remedy


@pytest.mark.parametrize("way", WAYS)
def test_who_looks_for_the_truth_is_caught(way: str, third_party: dict[str, ModuleType]) -> None:
    """By the check of honesty, whether what is found is used or not, and though every exception is swallowed."""
    found = failures(third_party["dishonest"].Dishonest(way=way))
    assert "honesty" in found, found
    assert "input" not in found


def test_what_lies_about_is_taken_away_again(third_party: dict[str, ModuleType]) -> None:
    """No decoy stays on a problem, in the environment or in the folder."""
    before, folder = dict(os.environ), Path.cwd()
    candidate = Candidate(third_party["good"].Good())
    assert candidate.elsewhere[1].seen == []
    assert (dict(os.environ), Path.cwd()) == (before, folder)


def main(words: list[str]) -> int:
    """Check a package, which is the word without a field."""
    return bench_main(["check", *(word if "=" in word else f"package={word}" for word in words)])


def said(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, list[dict[str, object]]]:
    status = main([*arguments, "format=json"])
    return status, [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_a_system_is_checked_with_its_options(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["chain", "system.n=3"]) == 0
    assert "9 parameters, 3 DOF" in capsys.readouterr().out


def test_the_command_passes_a_good_file(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(FOLDER / "good.py")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "method good (good:Good)"
    assert lines[-1] == f"{len(METHOD_CHECKS)} of {len(METHOD_CHECKS)} checks passed"


def test_the_command_refuses_a_sloppy_one_with_the_remedy(capsys: pytest.CaptureFixture[str]) -> None:
    status, found = said(capsys, str(FOLDER / "sloppy.py"), "method.fault=metres_only")
    assert status == 1
    failed = {str(one["name"]): one for one in found if not one["passed"]}
    assert set(failed) == {"units, mm", "units, both, start unknown"}
    assert "natural units" in str(failed["units, mm"]["remedy"])


ENDLESS = {
    "dies": "exited with status 3",
    "exits": "exited with status 1",
    "hangs": "the limit of 5 s",
    "floods": "File too large",
    "eats": "MemoryError",
    "raises_bytes": "raised RuntimeError: \\udcff",
}


@pytest.mark.parametrize(("fault", "words"), ENDLESS.items())
def test_a_method_without_an_answer_fails_that_check_and_none_behind_it_is_tried(
    fault: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    status, found = said(capsys, str(FOLDER / "sloppy.py"), f"method.fault={fault}", "timeout_s=5")
    assert status == 1
    assert [(one["name"], one["passed"]) for one in found] == [("card", True), ("imports", True), ("answer", False)]
    assert words in str(found[-1]["found"])


def test_a_process_that_dies_later_costs_one_check(capsys: pytest.CaptureFixture[str]) -> None:
    status, found = said(capsys, str(FOLDER / "sloppy.py"), "method.fault=dies_on_few")
    assert status == 1
    assert len(found) == len(METHOD_CHECKS)
    assert [one["name"] for one in found if not one["passed"]] == ["five samples"]


def test_the_command_catches_a_dishonest_one(capsys: pytest.CaptureFixture[str]) -> None:
    status, found = said(capsys, str(FOLDER / "dishonest.py"))
    assert status == 1
    assert [one["name"] for one in found if not one["passed"]] == ["honesty"]


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ([], "package=: needed: file"),
        (["nowhere.py"], "package=nowhere.py: there is no such file"),
        (["no_such_package"], "package=no_such_package: a file, a folder"),
        (["."], "it has no pyproject.toml"),
        ([str(FOLDER / "good.py"), "timeout_s=never"], "timeout_s=never: a positive number"),
        ([str(FOLDER / "good.py"), "method.width=3"], "method.width=3: settings of good: none"),
        ([str(FOLDER / "good.py"), "format=xml"], "format=xml: table or json"),
        ([str(FOLDER / "good.py"), "method.=3"], "method.=3: write method.<name>"),
        (["chain", "system.n=0"], "one mass"),
        (["json"], "no class in it subclasses"),
    ],
)
def test_bad_input_is_one_line(
    arguments: list[str], line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    out, error = capsys.readouterr()
    assert out == ""
    assert line in error
    assert error.count("\n") == 1


def test_a_package_that_is_missing_is_named_before_anything_is_checked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (
        (FOLDER / "good.py").read_text().replace("    serves:", "    requires = ('a_package_of_nobody',)\n    serves:")
    )
    (tmp_path / "needy.py").write_text(text)
    assert main([str(tmp_path / "needy.py")]) == 2
    assert "a_package_of_nobody" in capsys.readouterr().err


def test_a_file_that_cannot_be_imported_is_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, text in {"broken": "import nothing_of_that_name\n", "ends": "import os\nos._exit(4)\n"}.items():
        (tmp_path / f"{name}.py").write_text(text)
        assert main([str(tmp_path / f"{name}.py")]) == 2
        error = capsys.readouterr().err
        assert "cannot be imported" in error
        assert error.count("\n") == 1
