"""The calibration table from stored rows whose levels are known."""

from __future__ import annotations

import numpy as np
import pytest

from bench.contract.estimate import Status
from bench.reporting.frame import Frame, Result
from bench.reporting.tables.calibration import calibration_table, lines
from bench.scenario.scenario import Scenario
from bench.scoring.row import Row
from bench.store.cell import Cell
from bench.store.stored import StoredCell


def stored(levels: np.ndarray, band: float | None) -> StoredCell:
    """A cell whose rows have these levels at the truth for k/m, and none for c/m."""
    extra = {} if band is None else {"band_inside_95": band}
    rows = tuple(Row(i, Status.OK, scores={"k_over_m_pit": float(v), **extra}) for i, v in enumerate(levels))
    return StoredCell("x", {}, rows, {}, {}, {}, 0.0, {})


@pytest.fixture
def found(reference: Scenario) -> list[Result]:
    even = (np.arange(200) + 0.5) / 200
    # half the standard deviation: the normal score of every level is doubled
    from scipy import stats

    doubled = stats.norm.cdf(2.0 * stats.norm.ppf(even))
    cells = [Cell(reference, name, {}, 200, 0, name) for name in ("shooting", "pinn")]
    pairs = zip(cells, (stored(even, 0.9), stored(doubled, None)), strict=True)
    return [Result.of_cell(cell, own) for cell, own in pairs]


def test_honest_and_halved_uncertainties_are_told_apart(found: list[Result]) -> None:
    data = {(line["method"], line["quantity"]): line for line in lines(found)}
    honest, halved = data["shooting", "k_over_m"], data["pinn", "k_over_m"]
    assert honest["verdict"] == "calibrated"
    assert honest["coverage_95"] == pytest.approx(0.95)
    assert "too sure" in halved["verdict"]
    assert halved["rms_z"] == pytest.approx(2.0, rel=0.02)
    # doubled scores beyond 1.96 are scores beyond 0.98: 67 % remain inside
    assert halved["coverage_95"] == pytest.approx(0.67, abs=0.01)
    assert data["pinn", "c_over_m"]["verdict"] == "-"
    text = calibration_table(Frame("calibration", "T", {}, tuple(found)))["calibration.md"]
    assert "| 90.0" in text
    assert "too sure" in text


def test_few_replicates_are_counted_and_have_no_verdict(reference: Scenario) -> None:
    cell = Cell(reference, "pinn", {}, 10, 0, "pinn")
    few = Result.of_cell(cell, stored(np.array([0.5, *[0.999] * 9]), None))
    line = next(line for line in lines([few]) if line["quantity"] == "k_over_m")
    assert (line["coverage_95"], line["verdict"], line["n"]) == (0.1, "-", 10)


def test_a_store_without_its_cells_gives_no_table(reference: Scenario) -> None:
    missing = Result.of_cell(Cell(reference, "pinn", {}, 200, 0, "pinn"), None)
    assert calibration_table(Frame("calibration", "T", {}, (missing,))) == {}
