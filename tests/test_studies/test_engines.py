"""The benchmark of engines: its children and their limits, its sentences, and the other engines."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.config.experiment import expand
from bench.entrants.registry import make_method
from bench.scenario.truth import closed_form
from tests.studies.engines import children, page, peers, results, rivals
from tests.studies.engines.__main__ import main
from tests.studies.engines.children import ROOT, Outcome, answered
from tests.studies.engines.picture import picture, stored_growths
from tests.studies.engines.results import Growth, Result
from tests.studies.engines.row import METHOD_STREAM
from tests.studies.engines.rows import CURVES, SEED, Row

SDOF = Row("ls", "least squares", ("system=sdof",), "ls", {}, 2, goal_s=60.0, rounds=1, repeats=2)
LIMIT = "from tests.studies.engines.row import limit_memory"


def answer(values: Mapping[str, float], errors: Mapping[str, float], status: str = "ok") -> dict[str, Any]:
    return {"status": status, "message": "", "evaluations": 3, "values": dict(values), "errors": dict(errors)}


def outcome(k: float, status: str = "ok", seconds: float = 0.01, data: str = "a") -> Outcome:
    own = answer({"k": k, "c": 1.0}, {"k": 0.1, "c": 0.2}, status)
    return Outcome((3.0 * seconds, seconds), (own,), data, 100.0)


# ------------------------------------------------------------------------------------------------ children


def test_a_child_fits_as_this_process_does() -> None:
    """The same data sets, one by one and in this process."""
    found = children.measured(SDOF.task(60.0))
    assert found.failure == ""
    assert len(found.answers) == 2
    scenario, method = expand(["method=prior", "system=sdof"], multirun=False)[0].scenario, make_method("ls", {})
    make = scenario.maker(SEED)
    for i, own in enumerate(found.answers):
        estimate = method.identify(make(i)[0], np.random.default_rng([METHOD_STREAM, SEED, i]))
        distribution = estimate.groups
        for j, name in enumerate(distribution.names):
            assert own["values"][name] == pytest.approx(math.log(distribution.mean[j]), abs=1e-9)
            relative = math.sqrt(distribution.covariance[j, j]) / distribution.mean[j]
            assert own["errors"][name] == pytest.approx(relative, rel=1e-6)


@pytest.mark.parametrize(
    ("script", "limit_s", "said"),
    [
        ("while True: pass", 1.0, "not in 1 s"),
        (f"{LIMIT}; limit_memory(2000); bytearray(3 * 2**30)", 120.0, "out of memory"),
        ("raise ValueError('so')", 120.0, "crashed: ValueError: so"),
        ("print('a word')\nprint('[1]')", 120.0, [1]),
    ],
)
def test_what_ends_a_child_is_an_entry(script: str, limit_s: float, said: object) -> None:
    assert answered(["-c", script], {"limit_s": limit_s}) == said


@pytest.mark.slow
def test_both_codes_take_turns_and_agree_with_themselves() -> None:
    found = results.measure(replace(SDOF, rounds=2), 60.0, ROOT / "tests" / "..")
    assert found.before is not None
    assert len(found.now.seconds) == 4  # two runs in each of two children
    assert results.same_answers(found) == "equal"


# ------------------------------------------------------------------------------------------------ what came out


def test_a_difference_is_in_standard_errors() -> None:
    """0.05 of a standard error of 0.1 is a half; a parameter that moved by less does not hide it."""
    now, before = outcome(2.05), outcome(2.0)
    assert results.difference(now, before) == pytest.approx(0.5)
    assert results.same_answers(Result(SDOF, now, before)) == "0.5"
    assert results.same_answers(Result(SDOF, outcome(2.0), before)) == "equal"
    assert results.same_answers(Result(SDOF, outcome(2.0, "diverged"), before)) == "equal; 1 other statuses"
    assert results.same_answers(Result(SDOF, outcome(2.0, data="b"), before)) == "other data"
    assert results.same_answers(Result(SDOF, now, None)) == "-"


def test_goals_and_ratios() -> None:
    """The best run counts: 0.01 s of 0.01 and 0.03."""
    row = replace(SDOF, goal_s=0.01, goal_mb=100.0)
    held = Result(row, outcome(2.0), outcome(2.0, seconds=0.05))
    assert held.held
    assert held.ratio == pytest.approx(5.0)
    late = replace(held, before=Outcome(failure="not in 9 s"), limit_s=9.0)
    assert late.ratio_text == "> 450 ×"  # 9 s over 2 fits of 0.01 s
    assert math.isnan(late.ratio)
    slow = Result(replace(row, goal_s=0.004, goal_mb=80.0), outcome(2.0), None)
    assert not slow.held
    assert not Result(row, Outcome(failure="not in 120 s"), None).held
    assert not Result(row, outcome(2.0, "diverged"), None).held
    assert Result(replace(row, goal_s=math.nan), outcome(2.0), None).held is None


def test_an_exponent_is_of_the_upper_half() -> None:
    sizes = np.array([1.0, 3.0, 10.0, 30.0, 100.0, 300.0])
    law = 0.02 * sizes**1.7
    assert results.exponent(sizes, law) == pytest.approx(1.7)
    law[:3] = 5.0
    assert results.exponent(sizes, law) == pytest.approx(1.7)
    assert results.exponent([2, 4], [1.0, 8.0]) == pytest.approx(3.0)
    assert math.isnan(results.exponent([2], [1.0]))


# ------------------------------------------------------------------------------------------------ other engines

TIMES = np.linspace(0.0, 10.0, 25)
DATA = rivals.Data(TIMES, closed_form({"m": 2.0, "c": 0.8, "k": 16.0}, 1.0, 0.5, TIMES), np.array([1.0, 0.5]), 2.0)


@pytest.mark.parametrize("name", rivals.RIVALS)
def test_an_engine_finds_the_parameters_of_a_closed_form(name: str) -> None:
    package, _, fit = rivals.RIVALS[name]
    pytest.importorskip(package)
    c, k = fit(DATA, 0.9, 15.0)
    assert c == pytest.approx(0.8, rel=1e-3)
    assert k == pytest.approx(16.0, rel=1e-3)


# ------------------------------------------------------------------------------------------------ page


def test_the_page_counts(tmp_path: Path) -> None:
    good = Result(replace(SDOF, goal_s=1.0), outcome(2.05), outcome(2.0, seconds=0.04))
    bad = Result(replace(SDOF, title="another", goal_s=1.0), Outcome(failure="not in 120 s"), None)
    growth = Growth(CURVES[0], (1, 3, 10), (1.0, 3.0, 10.0))
    study = page.Study([good, bad], [growth], [peers.Peer("shooting", "ours", "its own", 0.1)], 120.0)
    text = page.page(study)
    assert "1 of 2 goals are held. The earlier code takes 4 to 4 times as long" in text
    twice = page.said_of_rows([good, replace(good, before=outcome(2.05, seconds=0.005))])
    assert "0.5 to 4 times as long, 2.25 in the median of 2; slower now by more than a tenth: least" in twice
    assert "exponent 1.00" in text
    data = page.tidy(study)
    assert list(data[data.part == "rows"].seconds.dropna()) == [0.01, 0.04]
    assert [path.suffix for path in picture([growth], tmp_path)] == [".png"]
    assert [(own.curve, own.sizes, own.seconds) for own in stored_growths(data)] == [
        (CURVES[0], (1, 3, 10), (1, 3, 10))
    ]


@pytest.mark.slow
def test_a_row_by_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["rows=bound", f"out={tmp_path}"]) == 0
    assert capsys.readouterr().out.split() == [str(tmp_path / name) for name in ("engines.md", "engines.csv")]
    assert "bound of a new linear scenario" in (tmp_path / "engines.md").read_text(encoding="utf-8")
