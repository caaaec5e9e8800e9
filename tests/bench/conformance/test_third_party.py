"""A good, a sloppy and a dishonest method of somebody else: passed, refused with a remedy, caught."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
from conftest import Python, install

from bench import Identifier
from bench.commands.main import main
from bench.conformance.check import CheckOutcome
from bench.conformance.method_checks import METHOD_CHECKS, Candidate

FOLDER = Path(__file__).parent / "third_party"
FAULTS = {
    "changes_the_input": "input",
    "global_stream": "seed",
    "no_seed": "seed",
    "starts_from_the_last": "state",
    "order_of_a_set": "state",
    "looks_at_its_neighbours": "batch",
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
WAYS = (
    "attribute",
    "frames",
    "gc",
    "store",
    "variable",
    "main_file",
    "scenario_files",
    "seed",
)


@pytest.fixture
def third_party(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, ModuleType]]:
    """Their modules, as whoever has them on the path imports them."""
    monkeypatch.syspath_prepend(str(FOLDER))
    names = ("good", "sloppy", "dishonest")
    yield {name: __import__(name) for name in names}
    for name in names:
        sys.modules.pop(name, None)


def failures(method: Identifier, *names: str) -> dict[str, CheckOutcome]:
    """Return what fails of the checks of these names, by default of all."""
    candidate = Candidate(method)
    outcomes = [check.outcome(candidate) for check in METHOD_CHECKS if not names or check.name in names]
    return {outcome.name: outcome for outcome in outcomes if not outcome.passed}


@pytest.mark.filterwarnings("ignore:a warning with its place")
def test_good_methods_pass_whatever_they_do_besides(third_party: dict[str, ModuleType]) -> None:
    """Who logs and warns, or sends the problem to another process, is not taken for one who looks for a truth."""
    sloppy = third_party["sloppy"].Sloppy
    for method in (third_party["good"].Good(), third_party["dishonest"].Dishonest(way="none")):
        assert failures(method) == {}
    for fault in ("only_talks", "only_copies"):
        assert failures(sloppy(fault=fault), "answer", "seed", "honesty", "input") == {}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_seen_by_its_check_and_has_a_remedy(fault: str, third_party: dict[str, ModuleType]) -> None:
    (failed,) = failures(third_party["sloppy"].Sloppy(fault=fault), FAULTS[fault]).values()
    assert len(failed.message.split()) >= 3
    assert len(failed.remedy.split()) >= 4
    assert "\n" not in failed.message + failed.remedy


@pytest.mark.parametrize("way", WAYS)
def test_who_looks_for_the_truth_is_caught(way: str, third_party: dict[str, ModuleType]) -> None:
    """By the check of honesty, though every exception is swallowed."""
    assert list(failures(third_party["dishonest"].Dishonest(way=way), "honesty", "input")) == ["honesty"]


def test_decoys_are_taken_away_again(third_party: dict[str, ModuleType]) -> None:
    before, folder = dict(os.environ), Path.cwd()
    _, looks, untouched = Candidate(third_party["good"].Good()).second
    assert (looks, untouched) == ([], True)
    assert (dict(os.environ), Path.cwd()) == (before, folder)


def checked(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, list[dict[str, object]]]:
    status = main(["check", *arguments, "format=json"])
    return status, [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_the_command_passes_a_system_with_its_options(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "package=chain", "system.n=3"]) == 0
    assert "9 parameters, 3 DOF" in capsys.readouterr().out


def test_an_installed_package_is_known_by_its_name(tmp_path: Path, python: Python) -> None:
    """As ``pip install`` leaves it: by the name of the distribution, of its module and of the method alike."""
    (tmp_path / "good.py").write_text((FOLDER / "good.py").read_text())
    env = install(tmp_path, "Somebodys_Methods", "[bench.methods]\nother_name = good:Good\n")
    code = (
        "from bench.conformance.subjects import subjects_of\n"
        "print({tuple(*subjects_of(name)) for name in ('somebodys-methods', 'good', 'other_name')})"
    )
    done = python("-c", code, env=env)
    assert done.stdout == "{('method', 'other_name', 'good:Good')}\n", done.stderr


@pytest.mark.parametrize(("fault", "words"), [
    ("dies", "exited with status 3"), pytest.param("hangs", "the limit of 5 s", marks=pytest.mark.slow),
    ("floods", "File too large"), ("raises_bytes", "raised RuntimeError: \\udcff"),
])  # fmt: skip
def test_a_method_without_an_answer_fails_that_check_and_none_behind_it_is_tried(
    fault: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    status, outcomes = checked(capsys, f"package={FOLDER / 'sloppy.py'}", f"method.fault={fault}", "timeout_s=5")
    assert status == 1
    assert [(one["name"], one["passed"]) for one in outcomes] == [("card", True), ("imports", True), ("answer", False)]
    assert words in str(outcomes[-1]["message"])


def test_a_process_that_dies_later_costs_one_check(capsys: pytest.CaptureFixture[str]) -> None:
    status, outcomes = checked(capsys, f"package={FOLDER / 'sloppy.py'}", "method.fault=dies_on_few")
    assert status == 1
    assert len(outcomes) == len(METHOD_CHECKS)
    assert [one["name"] for one in outcomes if not one["passed"]] == ["five samples"]
