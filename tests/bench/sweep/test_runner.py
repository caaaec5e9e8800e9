"""From cells to stored rows: paired, resumable, honest about failures, and blind to the truth."""

from __future__ import annotations

import math
import shutil
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import misbehaving
import numpy as np
import pytest
from conftest import Plugins, StoreFactory

from bench import InputError, Status
from bench.engine.pool import Limits
from bench.engine.progress import Look
from bench.entrants.registry import default_settings, load_method, make_method, missing_package
from bench.scenario.scenario import ForceSpec, Scenario
from bench.store.cell import Cell
from bench.store.store import Store
from bench.store.stored import StoredCell
from bench.sweep import runner
from bench.sweep.plan import plan
from bench.sweep.runner import run_cells


@pytest.fixture(autouse=True)
def _plugins(plugins: Plugins) -> None:
    """Register the test doubles as an installed package would."""
    plugins("Wrong", "Draw", "Spy", "Needy", "FreeOnly", "Exact", "Sole", "NotAMethod", "Missing")


@pytest.fixture
def store(new_store: StoreFactory) -> Store:
    return new_store()


def a_cell(scenario: Scenario, method: str, replicates: int = 3, seed: int = 0, **settings: Any) -> Cell:
    known = {} if method in ("oracle", "prior") else default_settings(method)
    return Cell(scenario, method, {**known, **settings}, replicates, seed, method)


def run(
    store: Store, *cells: Cell, workers: int = 2, retry: Any = (), timeout_s: float = 60.0, memory_mb: float = 2000.0
) -> list[StoredCell]:
    run_cells(plan(cells, store, retry), store, Limits(workers, timeout_s, memory_mb))
    found = [store.load(cell.identity) for cell in cells]
    assert all(found)
    return [cell for cell in found if cell]


def test_a_method_never_meets_the_truth(reference: Scenario, store: Store) -> None:
    """The spy searches the bytes it is given and every object in its process, right after the oracle has run."""
    oracle, spied = run(store, a_cell(reference, "oracle", 4), a_cell(reference, "spy", 4))
    assert (oracle.n_ok, spied.n_ok) == (4, 4)
    assert {row.message for row in spied.rows} == {"given [] alive [] saw Problem"}


def test_values_without_uncertainty_are_not_judged_by_intervals(reference: Scenario, store: Store) -> None:
    """The prior's step, which gives them a scale, makes no belief of them."""
    stated, alone = run(store, a_cell(reference, "exact", 2), a_cell(reference, "sole", 2))
    assert "k_over_m_coverage_95" in stated.rows[0].scores
    assert not [name for name in alone.rows[0].scores if "coverage" in name or "pit" in name or "crps" in name]
    assert alone.rows[0].scores["k_over_m_error_pct"] == pytest.approx(12.5, abs=0.1)


def test_the_spy_does_find_a_truth_where_there_is_one(reference: Scenario) -> None:
    problem, truth = reference.replicates(0, 1)[0]
    object.__setattr__(problem, "name", truth)
    found = misbehaving.Spy().identify(problem, np.random.default_rng(0)).message
    assert "given ['Truth']" in found
    assert "Scenario" in found.partition("alive")[2]


@pytest.mark.parametrize(
    ("kind", "status"),
    [
        ("raise", Status.CRASHED),
        ("type", Status.CRASHED),
        ("nan", Status.NONFINITE),
        ("misshapen", Status.INVALID),
        ("raising_reconstruction", Status.INVALID),
    ],
)
def test_a_method_that_goes_wrong_is_a_stored_row(reference: Scenario, store: Store, kind: str, status: Status) -> None:
    (cell,) = run(store, a_cell(reference, "wrong", 2, kind=kind))
    assert cell.status is status
    for row in cell.rows:
        assert row.status is status
        assert row.message
        assert row.scores == {}
    assert cell.summary["rmse"]["median"] == math.inf
    assert store.load(cell.identity) is not None


def test_a_problem_that_a_method_cannot_take_is_unsupported_with_a_sentence(
    reference: Scenario, store: Store, any_bound: None
) -> None:
    forced = replace(reference, force=ForceSpec(1.0, 0.1, 1.0))
    (cell,) = run(store, a_cell(forced, "freeonly", 2))
    assert cell.status is Status.UNSUPPORTED
    assert {row.message for row in cell.rows} == {"it cannot use a known force"}


def test_a_missing_package_is_a_row_with_the_install_line_and_runs_once_it_is_there(
    reference: Scenario, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell = a_cell(reference, "needy", 2)
    (stored,) = run(store, cell)
    assert stored.status is Status.MISSING_DEPENDENCY
    assert "pip install 'vibration-bench[needy]'" in stored.rows[0].message
    assert "a_package_that_nobody_has" in stored.rows[0].message
    (again,) = run(store, cell)
    assert again.status is Status.MISSING_DEPENDENCY
    monkeypatch.setattr(misbehaving.Needy, "requires", ())
    (now,) = run(store, cell)
    assert now.status is Status.CRASHED  # it ran: its worker still finds nothing to do but raise


def test_rows_are_the_same_however_many_workers_there_are(reference: Scenario, store: Store, tmp_path: Path) -> None:
    """A replicate's random stream hangs on scenario, seed, method and number, not on who computes it, or when."""
    other = Store(tmp_path / "other")
    other.prepare()
    shutil.copytree(store.bounds, other.bounds)
    (one,) = run(store, a_cell(reference, "draw", 9), workers=1)
    (two,) = run(other, a_cell(reference, "draw", 9), workers=2)
    for first, second in zip(one.rows, two.rows, strict=True):
        assert (first.replicate, first.message, first.scores) == (second.replicate, second.message, second.scores)
    assert len({row.message for row in one.rows}) == 9
    longer = run(other, a_cell(reference, "draw", 10))[0]
    assert [row.message for row in longer.rows[:9]] == [row.message for row in one.rows]
    assert [row.replicate for row in longer.rows] == list(range(10))


def test_a_finished_cell_is_found_and_not_computed_again(
    reference: Scenario, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell = a_cell(reference, "prior", 3)
    (first,) = run(store, cell)
    stamp = store.path(cell.identity).stat().st_mtime_ns

    def never(*arguments: Any, **options: Any) -> Any:
        raise AssertionError("computed again")

    monkeypatch.setattr(runner, "Children", never)
    (second,) = run(store, cell)
    assert store.path(cell.identity).stat().st_mtime_ns == stamp
    assert second.rows == first.rows


def test_a_sweep_computes_only_what_is_missing_and_keeps_the_order(
    reference: Scenario, store: Store, any_bound: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    cells = [a_cell(replace(reference, snr_db=snr), "prior", 2) for snr in (40.0, 20.0, 10.0)]
    run(store, cells[1])
    states = [(one.state.value, one.run) for one in plan([*cells, cells[0]], store)]
    assert states == [("missing", True), ("done", False), ("missing", True)]  # asked for twice is computed once
    stamp = store.path(cells[1].identity).stat().st_mtime_ns
    results = run(store, *cells, cells[0])
    assert store.path(cells[1].identity).stat().st_mtime_ns == stamp
    assert [result.identity for result in results] == [cell.identity for cell in [*cells, cells[0]]]


def test_a_cell_is_stored_as_soon_as_it_is_done(reference: Scenario, store: Store, any_bound: None) -> None:
    """A stop in the middle loses no finished cell, and leaves neither a half one nor a process."""
    cells = [a_cell(reference, "prior", 2), a_cell(reference, "wrong", 2, kind="sleep")]

    def stop(look: Look) -> None:
        if not look.done:
            return
        deadline = time.monotonic() + 60
        while store.load(cells[0].identity) is None and time.monotonic() < deadline:
            time.sleep(0.05)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_cells(plan(cells, store), store, Limits(1), stop)
    assert store.load(cells[0].identity) is not None
    assert store.load(cells[1].identity) is None
    assert list(store.claims.iterdir()) == []


def test_the_oracle_attains_the_bound(reference: Scenario, store: Store) -> None:
    """Root mean square over bound is near 1; with 40 replicates its standard error is 1/√80 = 0.11, so 4 of them."""
    (cell,) = run(store, a_cell(reference, "oracle", 40))
    assert cell.n_ok == 40
    for metric in ("k_over_m_error_pct", "c_over_m_error_pct", "m_error_pct"):
        assert cell.summary[metric]["excess"] == pytest.approx(1.0, abs=0.45), metric
    assert cell.summary["k_over_m_coverage_95"]["mean"] >= 0.8  # 34 of 40 or fewer has probability 1e-3
    assert cell.prior_share["m"] > 0.99
    assert cell.identifiable["m"] is False
    assert cell.identifiable["k_over_m"] is True


def test_the_prior_row_is_as_good_as_its_width(reference: Scenario, store: Store) -> None:
    """The error of m is that of a weighing of 2 %: a root mean square of 40 such errors is 2 % within 4 · 11 %."""
    (cell,) = run(store, a_cell(reference, "prior", 40))
    errors = np.array([row.scores["m_error_pct"] for row in cell.rows])
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(2.0, rel=0.45)
    coverage = [cell.summary[f"m_coverage_{level}"]["mean"] for level in (50, 80, 95)]
    assert coverage == pytest.approx([0.50, 0.80, 0.95], abs=0.3)
    assert [row.scores["realised_snr_db"] for row in cell.rows] == pytest.approx([20.0] * 40, abs=6.0)


def test_every_method_sees_the_same_data(reference: Scenario, store: Store) -> None:
    prior, oracle = run(store, a_cell(reference, "prior", 3), a_cell(reference, "oracle", 3))
    realised = [[row.scores["realised_snr_db"] for row in cell.rows] for cell in (prior, oracle)]
    assert realised[0] == realised[1]
    assert len(set(realised[0])) == 3


def test_what_a_stored_cell_says_of_itself(reference: Scenario, store: Store) -> None:
    (cell,) = run(store, a_cell(reference, "prior", 2))
    assert cell.cell["method"] == "prior"
    assert cell.cell["data"]["parameters"] == {"m": 1.0, "c": 0.4, "k": 8.0}
    assert cell.cell["sigma"] == pytest.approx(reference.sigmas(0).tolist())
    assert {"python", "packages", "cores", "commit", "dirty", "started", "limits", "data"} <= set(cell.provenance)
    assert cell.version == a_cell(reference, "prior", 2).version.as_json()
    assert cell.provenance["packages"]["numpy"] == np.__version__


@pytest.mark.parametrize("name", ["notamethod", "missing", "unknown"])
def test_an_entry_point_that_is_no_method_is_said_in_one_line(name: str) -> None:
    with pytest.raises(InputError, match=f"method={name}") as caught:
        load_method(name)
    assert len(str(caught.value).splitlines()) == 1


def test_settings_are_validated_by_their_types() -> None:
    assert default_settings("exact") == {"k_over_m": 9.0, "c_over_m": 0.5}
    made = make_method("exact", {"k_over_m": "7"})
    assert made == misbehaving.Exact(k_over_m=7.0)
    with pytest.raises(InputError, match=r"method\.k_over_m=soft"):
        make_method("exact", {"k_over_m": "soft"})
    with pytest.raises(InputError, match=r"method\.speed=3: settings of exact: k_over_m, c_over_m"):
        make_method("exact", {"speed": 3})
    assert missing_package("exact") is None
    assert missing_package("oracle") is None
