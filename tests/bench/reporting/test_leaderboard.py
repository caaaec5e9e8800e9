"""The leaderboard on errors whose order is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.contract.estimate import Status
from bench.reporting.frame import Frame, Result
from bench.reporting.tables.leaderboard import collected, leaderboard, lines, on_open_split
from bench.scenario.scenario import Scenario
from bench.scoring.row import Row
from bench.store.cell import Cell
from bench.store.stored import StoredCell


def result(scenario: Scenario, method: str, errors: np.ndarray) -> Result:
    rows = tuple(Row(i, Status.OK, scores={"rmse": float(v)}) for i, v in enumerate(errors))
    cell = Cell(scenario, method, {}, errors.size, 0, method)
    return Result.of_cell(cell, StoredCell(cell.identity, {}, rows, {}, {}, {}, 0.0, {}))


@pytest.fixture
def found(reference: Scenario) -> list[Result]:
    """Three scenarios; ls is three times worse than shooting on every data set, ddnn was given ten of forty."""
    rng = np.random.default_rng(0)
    entries = []
    for snr in (40.0, 20.0, 10.0):
        scenario = replace(reference, snr_db=snr)
        base = 10.0 ** (-snr / 20.0) * np.exp(rng.standard_normal(40))
        entries += [result(scenario, "shooting", base), result(scenario, "ls", 3.0 * base)]
        entries += [result(scenario, "ddnn", base[:10] * np.exp(0.3 * rng.standard_normal(10)))]
        entries += [result(scenario, "oracle", 0.1 * base)]
    return entries


def test_ratios_ties_and_shares(found: list[Result]) -> None:
    both = collected(found, "rmse")
    assert both is not None
    errors, _ = both
    assert set(errors.values) == {"shooting", "ls", "ddnn"}  # the oracle sees the truth and is no competitor
    assert errors.scenario.size == 30  # ten of each scenario, which all were given
    own = {line["method"]: line for line in lines(*both)}
    ratio = own["ls"]["ratio"] / own["shooting"]["ratio"]
    assert ratio == pytest.approx(3.0, rel=0.2)
    assert not own["ls"]["tie"]
    assert own["shooting"]["tie"]
    assert own["ddnn"]["tie"]
    assert own["ls"]["within_2"] < 0.2 < own["shooting"]["within_2"]
    assert own["ls"]["within_5"] > 0.8


def test_a_method_that_is_asked_for_some_scenarios_only_is_left_out(found: list[Result], reference: Scenario) -> None:
    some = [*found, result(reference, "nuts", np.ones(20))]
    both = collected(some, "rmse")
    assert both is not None
    assert set(both[0].values) == {"shooting", "ls", "ddnn"}


def test_the_open_split_is_the_median_and_gross_share_of_error_over_bound(reference: Scenario) -> None:
    """Errors of 0.5, 1, 2 and 10 bounds, and a failure: median 2, two of five beyond five times the bound."""
    results = []
    for i, ratio in enumerate((0.5, 1.0, 2.0, 10.0, np.inf)):
        own = result(replace(reference, snr_db=10.0 + i), "ls", np.array([ratio * (1.0 + i)]))
        stored = replace(own.stored, summary={"rmse": {"bound": 1.0 + i}})
        results.append(replace(own, stored=stored))
    found = on_open_split(results, "rmse")["ls"]
    assert found["median_over_bound"] == pytest.approx(2.0)
    assert found["gross"] == pytest.approx(0.4)
    assert found["gross_low"] < 0.4 < found["gross_high"]
    assert found["rms_over_bound"] == pytest.approx(np.sqrt((0.25 + 1 + 4 + 100) / 4))


def test_a_missing_cell_gives_no_leaderboard(found: list[Result], reference: Scenario) -> None:
    cells = [Cell(replace(reference, snr_db=snr), "rls", {}, 40, 0, "rls") for snr in (40.0, 20.0, 10.0)]
    missing = [Result.of_cell(cell, None) for cell in cells]
    assert collected([*found, *missing], "rmse") is None
    assert leaderboard([Frame("table4", "T", {}, (*found, *missing))]) == {}
    assert collected([*found, *missing[:2]], "rmse") is not None  # asked for some scenarios only
