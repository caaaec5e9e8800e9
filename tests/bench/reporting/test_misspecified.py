"""The table of wrong models says what was stored: median, bias, coverage, and what is wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.contract.estimate import Status
from bench.reporting.frame import Frame, Result
from bench.reporting.residuals import coloured, residuals
from bench.reporting.tables.misspecified import lines, misspecified_table
from bench.scenario.model_error import SecondMode
from bench.scenario.scenario import Scenario
from bench.scenario.truth import closed_form
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


def test_residuals_of_a_wrong_answer_are_coloured_and_those_of_the_truth_are_not(reference: Scenario) -> None:
    """At 40 dB: k/m right, and 10 % off; the response by the closed form must leave what the data leave."""
    scenario = replace(reference, snr_db=40.0)

    def answered(ratio: float, method: str) -> Result:
        rows = tuple(Row(i, Status.OK, scores={"k_over_m_ratio": ratio, "c_over_m_ratio": 1.0}) for i in range(20))
        cell = Cell(scenario, method, {}, 20, 0, method)
        return Result.of_cell(cell, StoredCell(cell.identity, {}, rows, {}, {}, {}, 0.0, {}))

    right, off = answered(1.0, "ls"), answered(1.1, "rls")
    found = coloured([right, off])
    assert found[right.identity].mean() <= 0.25
    assert np.all(found[off.identity])
    (problem, _) = scenario.replicates(0, 1)[0]
    channel = problem.records[0].channels[0]
    basis = np.stack([closed_form(scenario.parameters, *start, channel.times) for start in np.eye(2)], axis=1)
    best = np.linalg.lstsq(basis, channel.values, rcond=None)[0]
    left, start = residuals(channel.times, channel.values[None], np.array([[8.0, 0.4]]))
    np.testing.assert_allclose(start[0], best, atol=1e-9)
    np.testing.assert_allclose(left[0], channel.values - basis @ best, atol=1e-9)


def test_a_warning_and_a_fit_without_an_answer_count_as_said(reference: Scenario) -> None:
    rows = (Row(0, Status.OK, scores={}), Row(1, Status.OK, "doubtful", {}), Row(2, Status.DIVERGED, "no pole", {}))
    cell = Cell(reference, "ls", {}, 3, 0, "ls")
    (line, *_) = lines([Result.of_cell(cell, StoredCell(cell.identity, {}, rows, {}, {}, {}, 0.0, {}))])
    assert line["said"] == pytest.approx(2 / 3)
