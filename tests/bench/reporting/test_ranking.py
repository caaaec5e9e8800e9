"""The ranking on errors whose tiers are known by construction."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from bench.contract.estimate import Status
from bench.reporting.frame import Frame, Result
from bench.reporting.ranking import LOST, ON_BOUND, Ranked, fits_of, ranked, ranking, tiers
from bench.reporting.tables.leaderboard import leaderboard
from bench.scenario.force import ForceSpec
from bench.scenario.scenario import Scenario
from bench.scoring.row import Row
from bench.store.cell import Cell
from bench.store.stored import StoredCell

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


def fits(**means: np.ndarray) -> dict[str, list[np.ndarray]]:
    """One fit a scenario; NaN where the method does not serve it."""
    return {label: [own[np.isfinite(own)] for own in np.split(mean, mean.size)] for label, mean in means.items()}


def by_label(rows: list[Ranked]) -> dict[str, Ranked]:
    return {row.label: row for row in rows}


def test_tiers_are_what_the_scenarios_tell_apart() -> None:
    """Two methods on the bound, with draws of their own; two worse by 0.5, which is 6 standard errors; one by 2."""
    rng = np.random.default_rng(1)
    easy = rng.normal(0.0, 1.0, 150)
    losses = {
        label: easy + worse + rng.normal(0.0, 0.7, 150)
        for label, worse in {"c": 2.0, "b2": 0.5, "a1": 0.0, "b1": 0.5, "a2": 0.0}.items()
    }
    assert tiers(losses) == [["a1", "a2"], ["b2", "b1"], ["c"]]
    assert [row.tier for row in ranked(fits(**losses))] == [1, 1, 2, 2, 3]


def test_scenarios_are_paired() -> None:
    """A difference of 0.1 is lost in how hard the scenarios are, and sure on each of them."""
    easy = np.random.default_rng(2).normal(0.0, 1.0, 60)
    assert tiers({"worse": easy + 0.1, "better": easy}) == [["better"], ["worse"]]
    assert tiers({"worse": np.roll(easy, 7) + 0.1, "better": easy}) == [["worse", "better"]]


def test_a_tier_has_no_winner_and_less_than_two_percent_no_loser() -> None:
    rng = np.random.default_rng(3)
    easy = rng.normal(0.0, 1.0, 100)
    assert tiers({"later": easy + math.log(1.015), "first": easy}) == [["later", "first"]]
    assert tiers({"later": easy + math.log(1.03), "first": easy}) == [["first"], ["later"]]


def test_of_one_scenario_its_fits_are_compared() -> None:
    """Forty fits, all worse by 0.2; another method has the first ten, no worse than the best; one fit tells nothing."""
    noise = np.random.default_rng(5).normal(0.0, 1.0, 40)
    rows = ranked({"best": [noise], "worse": [noise + 0.2], "few": [noise[:10]]})
    assert {row.label: row.tier for row in rows} == {"best": 1, "few": 1, "worse": 2}
    assert tiers({"a": np.array([0.0]), "b": np.array([2.0])}) == [["a", "b"]]
    assert tiers({}) == []


def test_a_method_on_the_bound_has_a_typical_error_of_three_quarters(reference: Scenario) -> None:
    """E log sqrt((x² + y²) / 2) = -γ/2 of two standard normal numbers: half the logarithm of an exponential one's."""
    size = np.sqrt(np.mean(np.random.default_rng(4).standard_normal((2, 4000)) ** 2, axis=0))
    (row,) = ranking([result(reference, "shooting", *size)])
    assert row.typical == pytest.approx(math.exp(-np.euler_gamma / 2), rel=0.03)
    assert math.exp(-np.euler_gamma / 2) == pytest.approx(ON_BOUND)


def test_losses_are_capped_and_what_is_lost_is_counted(reference: Scenario) -> None:
    """Fits at 4 bounds, at 5.1, at 1e-5, without an answer and at 1e300."""
    (own,) = fits_of([result(reference, "ls", 4.0, 5.1, 1e-5, math.nan, 1e300)])["ls"]
    assert own == pytest.approx([math.log(4.0), LOST, -LOST, LOST, LOST])
    (row,) = ranking([result(reference, "ls", 4.0, 5.1, 1e-5, math.nan, 1e300)])
    assert (row.lost, row.fits) == (3, 5)


def test_an_error_of_either_quantity_alone_is_an_outlier(reference: Scenario) -> None:
    """k/m on its bound and c/m at six of its bounds: the root mean square is 4.3."""
    own = result(reference, "ls", 1.0)
    assert own.stored
    stored = replace(own.stored, rows=(Row(0, Status.OK, scores={K: 2.0, C: 42.0}),))
    assert ranking([replace(own, stored=stored)])[0].lost == 1


def test_what_the_data_do_not_determine_does_not_count(reference: Scenario) -> None:
    """A bound of 100 % of c/m leaves k/m; where both are as large there is no scenario."""
    poor = replace(reference, snr_db=3.0)
    (own,) = fits_of([result(reference, "ls", 3.0, **{K: 2.0, C: 100.0})])["ls"]
    assert own == pytest.approx([math.log(3.0)])
    rows = ranking([result(reference, "ls", 3.0), result(poor, "ls", 3.0, **{K: 150.0, C: 100.0})])
    assert [(row.served, row.scenarios) for row in rows] == [(1, 1)]


def test_a_refusal_counts_as_lost_where_the_method_says_that_it_serves(reference: Scenario) -> None:
    """The matrix pencil says that it takes no force; least squares takes one, and refused."""
    forced = replace(reference, force=ForceSpec(1.0, 0.1, 1.0))
    rows = by_label(ranking([
        result(reference, "shooting", 1.0), result(forced, "shooting", 2.0),
        result(reference, "matrix_pencil", 1.5), result(forced, "matrix_pencil", status=Status.UNSUPPORTED),
        result(reference, "ls", 1.0), result(forced, "ls", status=Status.UNSUPPORTED),
    ]))  # fmt: skip
    assert (rows["ls"].served, rows["ls"].lost, rows["ls"].fits) == (2, 1, 2)
    assert rows["ls"].typical == pytest.approx(math.sqrt(10.0))
    beside = rows["matrix_pencil"]
    assert (beside.tier, beside.served, beside.scenarios, beside.lost) == (0, 1, 2, 0)
    assert beside.typical == pytest.approx(1.5)


def test_what_stands_beside_is_compared_on_the_same_scenarios() -> None:
    """On the first hundred, where the best loses nothing, the other loses log 2; it does not serve the hard ones."""
    best = np.repeat([0.0, 1.5], 100)
    some = np.where(best == 0.0, math.log(2.0), math.nan)
    rows = ranked(fits(some=some, best=best, worst=best + 0.5))
    assert [row.label for row in rows] == ["best", "worst", "some"]
    beside = rows[-1]
    assert (beside.tier, beside.served, beside.scenarios) == (0, 100, 200)
    assert beside.typical == pytest.approx(2.0)
    assert beside.first_tier == pytest.approx(1.0)
    assert rows[0].low < rows[0].typical < rows[0].high


def test_errors_that_no_honest_method_has_are_said(reference: Scenario) -> None:
    """Forty fits at a fifth of the bound: chi-square of 40 is below 1.6 once in 10^30."""
    rng = np.random.default_rng(6)
    cheat, honest = (result(reference, name, *size) for name, size in
                     (("ls", np.full(40, 0.2)), ("shooting", abs(rng.standard_normal(40)))))  # fmt: skip
    assert {row.label: row.too_good for row in ranking([cheat, honest])} == {"ls": True, "shooting": False}
    assert "LS, finite differences" in leaderboard(Frame("open", "", {}, (cheat, honest)))["leaderboard.md"]


def test_references_compete_with_nobody_and_a_merged_method_keeps_its_mark(reference: Scenario) -> None:
    merged = replace(result(reference, "ls", 1.0), label="ls (submitted)")
    rows = ranking([result(reference, "oracle", 0.5), result(reference, "shooting", 1.0), merged])
    assert [row.label for row in rows] == ["shooting", "ls (submitted)"]


def drawn(scenario: Scenario, n: int) -> list[Scenario]:
    """Scenarios with 25 samples in 10 s at 0.25 Hz to 1 Hz, and as many with three in 10 s: beyond Nyquist."""
    stiffness = (2 * math.pi * np.linspace(0.25, 1.0, n)) ** 2
    made = [replace(scenario, parameters={"m": 1.0, "c": 0.1, "k": float(k)}) for k in stiffness]
    return [*made, *(replace(one, samples=3) for one in made)]


def test_the_leaderboard_has_tiers_apart_below_and_beyond_nyquist(reference: Scenario) -> None:
    """Shooting and the filter alike below, least squares three times worse; beyond all are lost but the filter."""
    rng = np.random.default_rng(7)
    results = []
    for scenario in drawn(reference, 30):
        sparse, size = scenario.samples == 3, float(np.exp(0.3 * rng.standard_normal()))
        results.append(result(scenario, "shooting", math.nan if sparse else size))
        results.append(result(scenario, "ekf", size * float(np.exp(0.02 * rng.standard_normal()))))
        results.append(result(scenario, "ls", math.nan if sparse else 3.0 * size))
        results.append(result(scenario, "oracle", 0.1))
    merged = result(drawn(reference, 30)[0], "rls", 1.0)
    assert merged.stored
    marked = merged.stored.marked({"by": "somebody", "rows_compared": 5, "of_rows": 24})
    results.append(replace(merged, label="rls (submitted)", stored=marked))
    files = leaderboard(Frame("open", "Open split", {}, tuple(results)))
    below, beyond = files["leaderboard.md"].split("## Below Nyquist: 30 scenarios")[1].split("## Beyond Nyquist: 30")
    rows = re.findall(r"^\| (\d) +\| ([^|]+?) +\| ([\d.]+)", below, re.MULTILINE)
    assert [(tier, name) for tier, name, _ in rows] == [
        ("1", "Multiple shooting"), ("1", "Extended Kalman filter"), ("2", "LS, finite differences"),
    ]  # fmt: skip
    assert float(rows[2][2]) / float(rows[0][2]) == pytest.approx(3.0, rel=0.02)
    assert re.search(r"RLS \(submitted\) +\| 1 of 30", below.split("Beside the tiers")[1])
    assert "RLS (submitted): submitted; 5 of its 24 rows were computed again" in files["leaderboard.md"]
    assert re.findall(r"^\| (\d) +\| (\w+)", beyond, re.MULTILINE) == [
        ("1", "Extended"),
        ("2", "Multiple"),
        ("2", "LS"),
    ]
    assert "oracle" not in files["leaderboard.md"].lower()


def test_a_store_without_the_open_split_has_no_leaderboard(reference: Scenario) -> None:
    cell = Cell(reference, "ls", {}, 1, 0, "ls")
    assert leaderboard(Frame("open", "", {}, (Result.of_cell(cell, None),))) == {}


def test_a_store_may_state_anything_of_a_verification(reference: Scenario) -> None:
    own = result(reference, "ls", 1.0)
    assert own.verification == ""
    assert own.stored
    stated = replace(own, stored=own.stored.marked({"rows_compared": "<script>", "of_rows": 24}))
    assert stated.verification == "submitted; what was verified of it is not stated"
