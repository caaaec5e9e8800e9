"""The ranking on errors whose tiers are known by construction."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.stats import bootstrap, studentized_range

from bench.contract.estimate import Status
from bench.reporting.frame import Frame, Result
from bench.reporting.page.tracks import track_rankings
from bench.reporting.ranking import LOST, ON_BOUND, first_tier, fits_of, ranked, ranking, tied, tiers
from bench.reporting.tables.leaderboard import leaderboard
from bench.scenario.force import ForceSpec
from bench.scenario.scenario import Scenario
from bench.scoring.row import Row
from bench.store.cell import Cell
from bench.store.stored_cell import StoredCell

K, C = "k_over_m_error_pct", "c_over_m_error_pct"
BOUNDS = {K: 2.0, C: 7.0}
TOLD = {"k_over_m": True, "c_over_m": True}


def result(scenario: Scenario, method: str, *ratios: float, status: Status = Status.OK, **bounds: float) -> Result:
    """A cell whose fits have these errors over the bounds, of k/m and c/m alike; NaN is a failure."""
    bounds = bounds or BOUNDS
    rows = [
        Row(i, Status.DIVERGED) if math.isnan(ratio)
        else Row(i, status, scores={metric: ratio * bound for metric, bound in bounds.items()})
        for i, ratio in enumerate(ratios)
    ]  # fmt: skip
    if status is not Status.OK:
        rows = [Row(0, status, "no")]
    cell = Cell(scenario, method, {}, len(rows), 0, method)
    summary = {metric: {"bound": bound} for metric, bound in bounds.items()}
    return Result.of_cell(cell, StoredCell(cell.identity, {"label": method}, tuple(rows), summary, {}, TOLD, 0.0))


def test_the_first_tier_is_what_an_independent_bootstrap_and_the_studentised_range_make_it() -> None:
    """Of two methods scipy's bootstrap of the paired differences; of ten independent ones Tukey's range (1949)."""
    rng = np.random.default_rng(0)
    for worse in np.linspace(0.02, 0.3, 15):
        easy, difference = rng.normal(0.0, 1.0, 80), worse + rng.normal(0.0, 0.5, 80)
        ends = bootstrap((difference,), np.mean, n_resamples=4000, method="percentile", rng=1).confidence_interval
        clear = min(abs(ends.low), abs(ends.high)) > 0.01  # the limits of so many resamples are known to 0.005
        assert not clear or (len(tiers({"a": easy, "b": easy + difference})) == 1) == (ends.low < 0 < ends.high)
    errors = rng.normal(0.0, 1.0, (10, 200))
    errors = (errors - errors.mean(axis=1, keepdims=True)) / errors.std(axis=1, keepdims=True)
    limit = studentized_range.ppf(0.95, 10, np.inf) / math.sqrt(200)
    for factor, together in ((0.93, 10), (1.07, 9)):
        last = np.arange(10)[:, None] == 9
        assert tied(errors + np.where(last, factor * limit, 0.0)) == together


@pytest.mark.parametrize("methods", [2, 8])
def test_equal_methods_share_a_tier_in_95_of_100_draws(methods: int) -> None:
    """Binomial: 300 draws at 95 % are 285, give or take 4."""
    whole = 0
    for seed in range(300):
        rng = np.random.default_rng([seed, methods])
        easy = rng.normal(0.0, 1.0, 60)
        whole += len(tiers({str(i): easy + rng.normal(0.0, 0.5, 60) for i in range(methods)})[0]) == methods
    assert 285 - 12 <= whole <= 285 + 12


def test_tiers_are_what_paired_scenarios_tell_apart_without_a_winner() -> None:
    """Two methods on the bound, with draws of their own; two worse by 0.5, which is 6 standard errors; one by 2.

    Without pairs 0.1 is lost in how hard the scenarios are; 2 % is a tie even where it is sure.
    """
    rng = np.random.default_rng(1)
    easy = rng.normal(0.0, 1.0, 150)
    losses = {
        label: easy + worse + rng.normal(0.0, 0.7, 150)
        for label, worse in {"c": 2.0, "b2": 0.5, "a1": 0.0, "b1": 0.5, "a2": 0.0}.items()
    }
    assert tiers(losses) == [["a1", "a2"], ["b2", "b1"], ["c"]]
    assert tiers({"worse": easy + 0.1, "better": easy}) == [["better"], ["worse"]]
    assert tiers({"worse": np.roll(easy, 7) + 0.1, "better": easy}) == [["worse", "better"]]
    assert tiers({"later": easy + math.log(1.015), "first": easy}) == [["later", "first"]]
    assert tiers({"later": easy + math.log(1.03), "first": easy}) == [["first"], ["later"]]


def test_of_one_scenario_its_fits_are_compared(reference: Scenario) -> None:
    """Forty fits, all worse by 0.2; another method has the first ten, no worse than the best; one fit tells nothing."""
    noise = np.random.default_rng(5).normal(0.0, 1.0, 40)
    rows = ranked({"best": [noise], "worse": [noise + 0.2], "few": [noise[:10]]})
    assert {row.label: row.tier for row in rows} == {"best": 1, "few": 1, "worse": 2}
    assert tiers({"a": np.array([0.0]), "b": np.array([2.0])}) == [["a", "b"]]
    assert tiers({}) == []
    sizes = abs(noise) + 0.1
    cells = [result(reference, name, *own) for name, own in
             {"ls": sizes, "ekf": sizes, "rls": 3 * sizes, "oracle": 0.1 * sizes}.items()]  # fmt: skip
    assert {cell.label for cell in first_tier(cells, [K])} == {"ls", "ekf"}
    assert first_tier(cells[2:], [K]) == first_tier(cells, ["m_error_pct"]) == frozenset()
    assert first_tier([result(reference, name, math.nan) for name in ("ls", "ekf")], [K]) == frozenset()


def test_a_method_on_the_bound_is_known_by_its_typical_error(reference: Scenario) -> None:
    """Two normal errors on the bound, drawn: the exponential integral of their mean square, which is exponential."""
    size = np.sqrt(np.mean(np.random.default_rng(4).standard_normal((2, 4000)) ** 2, axis=0))
    (row,) = ranking([result(reference, "shooting", *size)])
    assert row.typical == pytest.approx(ON_BOUND, rel=0.01)


def test_losses_are_capped_and_what_is_lost_is_counted(reference: Scenario) -> None:
    """Fits at 4 bounds, at 5.1, at 1e-5, without an answer, at 1e300, and with c/m alone at six of its bounds."""
    cell = result(reference, "ls", 4.0, 5.1, 1e-5, math.nan, 1e300)
    assert cell.stored
    rows = (*cell.stored.rows, Row(5, Status.OK, scores={K: 2.0, C: 42.0}))
    cell = replace(cell, stored=replace(cell.stored, rows=rows))
    assert fits_of([cell])["ls"][0] == pytest.approx([math.log(4.0), LOST, -LOST, LOST, LOST, LOST])
    (row,) = ranking([cell])
    assert (row.lost, row.fits) == (4, 6)


def test_what_the_data_do_not_determine_does_not_count(reference: Scenario) -> None:
    """A bound of 100 % of c/m leaves k/m; where both are as large there is no scenario."""
    poor = replace(reference, snr_db=3.0)
    (own,) = fits_of([result(reference, "ls", 3.0, **{K: 2.0, C: 100.0})])["ls"]
    assert own == pytest.approx([math.log(3.0)])
    rows = ranking([result(reference, "ls", 3.0), result(poor, "ls", 3.0, **{K: 150.0, C: 100.0})])
    assert [(row.served, row.scenarios) for row in rows] == [(1, 1)]


def test_a_refusal_counts_as_lost_where_the_method_says_that_it_serves(reference: Scenario) -> None:
    """The matrix pencil says that it takes no force; least squares takes one, and refused.

    What stands beside is compared on the scenarios that it serves: there the first tier has its bound, not twice that.
    """
    forced = replace(reference, force=ForceSpec(1.0, 0.1, 1.0))
    rows = {row.label: row for row in ranking([
        result(reference, "shooting", 1.0), result(forced, "shooting", 2.0),
        result(reference, "matrix_pencil", 1.5), result(forced, "matrix_pencil", status=Status.UNSUPPORTED),
        result(reference, "ls", 4.0), result(forced, "ls", status=Status.UNSUPPORTED),
        result(reference, "oracle", 0.1), result(forced, "oracle", 0.1),
    ])}  # fmt: skip
    assert list(rows) == ["shooting", "ls", "matrix_pencil"]
    assert (rows["ls"].served, rows["ls"].lost, rows["ls"].fits) == (2, 1, 2)
    assert rows["ls"].typical == pytest.approx(math.sqrt(40.0))
    beside = rows["matrix_pencil"]
    assert (beside.tier, beside.served, beside.scenarios, beside.lost) == (0, 1, 2, 0)
    assert beside.typical == pytest.approx(1.5)
    assert beside.first_tier == pytest.approx(1.0)


def test_errors_that_no_honest_method_has_are_said(reference: Scenario) -> None:
    """Forty fits at a fifth of the bound: chi-square of 40 is below 1.6 once in 10^30."""
    rng = np.random.default_rng(6)
    cheat, honest = (result(reference, name, *size) for name, size in
                     (("ls", np.full(40, 0.2)), ("shooting", abs(rng.standard_normal(40)))))  # fmt: skip
    assert {row.label: row.too_good for row in ranking([cheat, honest])} == {"ls": True, "shooting": False}
    assert "LS, finite differences" in leaderboard(Frame("open", "", {}, (cheat, honest)))["leaderboard.md"]


def test_the_leaderboard_has_tiers_apart_below_and_beyond_nyquist(reference: Scenario) -> None:
    """Thirty scenarios from 0.25 Hz with 25 samples in 10 s, and with three.

    Shooting and the filter alike below, least squares three times worse; beyond all are lost but the filter.
    """
    rng = np.random.default_rng(7)
    results = []
    for frequency in np.linspace(0.25, 1.0, 30):
        below = replace(reference, parameters={"m": 1.0, "c": 0.1, "k": float((2 * math.pi * frequency) ** 2)})
        for scenario, lost in ((below, 1.0), (replace(below, samples=3), math.nan)):
            size = 1.3 * float(np.exp(0.05 * rng.standard_normal()))
            near = size * float(np.exp(0.02 * rng.standard_normal()))
            sizes = {"shooting": size * lost, "ekf": near, "ls": 3.0 * size * lost, "oracle": 0.1}
            results += [result(scenario, name, own) for name, own in sizes.items()]
    merged = result(replace(reference, parameters=results[0].parameters), "rls", 1.0)
    assert merged.stored
    marked = merged.stored.marked({"by": "somebody", "rows_compared": 5, "of_rows": 24})
    results.append(replace(merged, label="rls (submitted)", stored=marked))
    text = leaderboard(Frame("open", "Open split", {}, tuple(results)))["leaderboard.md"]
    below_text, beyond_text = text.split("## Below Nyquist: 30 scenarios")[1].split("## Beyond Nyquist: 30")
    rows = re.findall(r"^\| (\d) +\| (\w+)[^|]*\| ([\d.]+)", below_text, re.MULTILINE)
    assert [row[:2] for row in rows] == [("1", "Multiple"), ("1", "Extended"), ("2", "LS")]
    assert float(rows[2][2]) / float(rows[0][2]) == pytest.approx(3.0, rel=0.02)
    assert re.search(r"RLS \(submitted\) +\| 1 of 30", below_text.split("do not serve every scenario")[1])
    assert "RLS (submitted): submitted; 5 of its 24 rows were recomputed" in text
    tiers_beyond = re.findall(r"^\| (\d) +\| (\w+)", beyond_text, re.MULTILINE)
    assert tiers_beyond == [("1", "Extended"), ("2", "Multiple"), ("2", "LS")]
    assert ranking(results[:-1]) == ranking(results[-2::-1])  # whoever reads them, in whatever order


def test_the_measured_and_the_online_track_are_ranked_by_the_same_rule(tmp_path: Path) -> None:
    """On eight rigs of two records ls leaves three times as much unexplained, ekf withdraws half, ar takes no record.

    A tracker is on the bound in each of twelve scenarios, one four times off, one serves half of them.
    """
    records = [
        {"set": f"rig{rig}", "system": "sdof", "method": method, "sibling": part, "status": status, "trust": trust,
         "held_out": 100.0 - left * (1 + rig), "wall_s": 0.1}
        for rig in range(8) for part in "ab"
        for method, left, status, trust in (
            ("shooting", 1.0, "ok", "trust"), ("ls", 3.0, "ok", "with care"), ("ar", math.nan, "unsupported", ""),
            ("ekf", 1.0, "ok", "do not trust" if part == "b" else "trust"))
    ]  # fmt: skip
    path = [
        {"scenario": i, "method": method, "quantity": "k", "excess": excess, "micros_median": 50.0}
        for i in range(12) for method, excess in (("bound", 1.0), ("ukf", 1.0), ("imm", 4.0), ("glr", 2.0))
        if method != "glr" or i % 2
    ]  # fmt: skip
    pd.DataFrame([*records, {**records[0], "sibling": "all", "status": None}]).to_csv(tmp_path / "table11.csv")
    pd.DataFrame(path).to_csv(tmp_path / "table10.csv")
    measured, online = track_rankings(tmp_path)
    rows = {row.label: (row.tier, row.lost, row.fits, round(row.typical, 2)) for row in measured.ranking}
    assert rows == {"shooting": (1, 0, 16, 1.0), "ls": (2, 0, 16, 3.0), "ekf": (3, 8, 16, round(math.sqrt(10.0), 2))}
    assert [(row.label, row.tier, row.served, round(row.typical, 2)) for row in online.ranking] == [
        ("UKF", 1, 12, 1.0), ("IMM", 2, 12, 4.0), ("likelihood ratio", 0, 6, 2.0)
    ]  # fmt: skip
    assert (measured.fastest.label, measured.seconds["ls"], online.seconds["UKF"]) == ("shooting", 0.1, 5e-5)
    (tmp_path / "table11.csv").write_text("of,another\n1,2\n")
    assert [advice.title for advice in track_rankings(tmp_path)] == [online.title]
