"""The table of wrong models says what was stored: median, bias, coverage, and what is wrong."""

from __future__ import annotations

from dataclasses import replace

import pytest

from bench.contract.estimate import Status
from bench.reporting.frame import Frame, Result
from bench.reporting.tables.misspecified import lines, misspecified_table
from bench.scenario.model_error import SecondMode
from bench.scenario.scenario import Scenario
from bench.scoring.row import Row
from bench.store.cell import Cell
from bench.store.stored import StoredCell


def result(scenario: Scenario) -> Result:
    """Ratios of 1.1, 1.3 and 0.9, one of three intervals right."""
    rows = tuple(
        Row(i, Status.OK, scores={"k_over_m_ratio": ratio, "k_over_m_coverage_95": float(i == 0)})
        for i, ratio in enumerate((1.1, 1.3, 0.9))
    )
    cell = Cell(scenario, "ls", {}, 3, 0, "ls")
    return Result.of_cell(cell, StoredCell(cell.identity, {}, rows, {}, {}, {}, 0.0, {}))


def test_bias_and_coverage_are_those_of_the_replicates(reference: Scenario) -> None:
    disturbed = result(replace(reference, disturbance=SecondMode(0.1)))
    line = next(line for line in lines([disturbed]) if line["quantity"] == "k_over_m")
    assert line["wrong"] == "second_mode"
    assert line["bias_pct"] == pytest.approx(10.0)
    assert line["coverage_95"] == pytest.approx(1 / 3)
    assert line["low_95"] < 1 / 3 < line["high_95"]


def test_panels_are_by_what_is_wrong(reference: Scenario) -> None:
    assert reference.prior is not None
    off = replace(reference, prior=replace(reference.prior, wrong=True))
    own = (result(reference), result(off), result(replace(reference, disturbance=SecondMode(0.1))))
    text = misspecified_table(Frame("misspecified", "Wrong", {}, own))["misspecified.md"]
    assert [line.split(";")[0] for line in text.splitlines() if line.startswith("## ")] == [
        "## Wrong: nothing", "## Wrong: wrong prior", "## Wrong: second mode",
    ]  # fmt: skip
    assert misspecified_table(Frame("misspecified", "Wrong", {}, own[:1])) == {}
