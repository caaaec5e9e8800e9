"""How many problems a method gets at once, and that its answers do not depend on it."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest
from conftest import Plugins, StoreFactory

from bench import Status
from bench.engine import pool
from bench.engine.pool import Limits, TaskQueue
from bench.entrants.registry import default_settings, make_method
from bench.scenario.scenario import Scenario
from bench.scoring.row import Row
from bench.store.cell import Cell
from bench.store.locks import Claims
from bench.store.store import Store
from bench.store.stored import StoredCell
from bench.sweep.cells import queue_cell
from bench.sweep.plan import Planned, State, plan
from bench.sweep.runner import run_cells, run_replicates
from bench.sweep.scoring_process import Scored


def a_cell(reference: Scenario, **settings: object) -> Cell:
    return Cell(reference, "together", {**default_settings("together"), **settings}, 20, 0, "together")


def rows_of(store: Store, cell: Cell) -> tuple[Row, ...]:
    run_cells(plan([cell], store), store, Limits(1, 30.0, 1000.0))
    stored = store.load(cell.identity)
    assert stored is not None
    return stored.rows


def test_a_sweep_hands_out_as_many_as_the_method_solves_together_and_the_scores_are_the_same(
    reference: Scenario, plugins: Plugins, new_store: StoreFactory
) -> None:
    plugins("Together")
    store = new_store()
    few, eight, all_of_them = (rows_of(store, a_cell(reference, batch=n)) for n in (1, 8, 100))
    assert {row.message for row in few[:5]} == {"5"}
    assert [row.message for row in eight] == ["8"] * 16 + ["4"] * 4
    assert {row.message for row in all_of_them} == {"20"}
    assert len({row.scores["k_over_m_error_pct"] for row in few}) == 20
    for rows in (eight, all_of_them):
        assert [(row.replicate, row.scores) for row in rows] == [(row.replicate, row.scores) for row in few]


@pytest.mark.parametrize(("each_s", "sizes"), [(2.0, [1, 1, 1]), (0.1, [5, 5, 5]), (1e-3, [24, 18, 14])])
def test_a_task_takes_about_half_a_second_and_leaves_some_for_the_other_workers(
    reference: Scenario, plugins: Plugins, new_store: StoreFactory, each_s: float, sizes: list[int]
) -> None:
    """Of 95 replicates left with two workers a quarter goes out at most; slow fits go out one by one."""
    plugins("Together")
    queued = queue_cell(
        Planned(replace(a_cell(reference), replicates=100), State.MISSING, "", True), new_store(), Limits(2)
    )
    assert queued.take() == (0, 1, 2, 3, 4)
    queued.rows = [Row(i, Status.OK, "", wall_s=each_s) for i in range(4)] + [Row(4, Status.INVALID)]
    assert [len(queued.take()) for _ in sizes] == sizes
    queued.alone.append(3)
    assert queued.take() == (3,)


def test_what_dies_in_company_is_tried_again_one_by_one(
    reference: Scenario, plugins: Plugins, new_store: StoreFactory
) -> None:
    plugins("Together")
    rows = rows_of(new_store(), a_cell(reference, batch=20, alone=True))
    assert {(row.status, row.message) for row in rows} == {(Status.OK, "1")}


@pytest.mark.parametrize(("settings", "wanted"), [({}, 1), ({"batch": 20}, 20)])
def test_the_batch_of_a_pinn_is_what_it_gets_in_a_sweep(settings: dict[str, int], wanted: int) -> None:
    assert make_method("pinn", settings).problems_at_once == wanted


def test_chosen_replicates_are_those_of_the_whole_cell_and_are_not_stored(
    reference: Scenario, plugins: Plugins, new_store: StoreFactory
) -> None:
    plugins("Together")
    store, chosen, found = new_store(), (3, 4, 11, 19), []
    cell = a_cell(reference)

    def on_rows(cell: Cell, rows: Sequence[Row]) -> None:
        found.extend(rows)

    wanted = [(Planned(cell, State.MISSING, "", True), chosen)]
    run_replicates(wanted, store, Limits(1, 30.0, 1000.0), on_rows, lambda look: None)
    assert store.identities() == []
    assert tuple(row.replicate for row in found) == chosen
    whole = {row.replicate: row for row in rows_of(store, cell)}
    stored_digits = [{name: float(f"{v:.6g}") for name, v in row.scores.items()} for row in found]
    assert stored_digits == [whole[i].scores for i in chosen]
    assert [row.data for row in found] == [whole[i].data for i in chosen]


def planned_cells(reference: Scenario, n: int) -> list[Planned]:
    return [Planned(replace(a_cell(reference), seed=seed, replicates=1), State.MISSING, "", True) for seed in range(n)]


def test_no_cell_is_begun_while_the_store_is_behind(
    reference: Scenario, plugins: Plugins, new_store: StoreFactory
) -> None:
    """Of ten cells that take no time two are complete, each with its claim, until one of them is stored."""
    plugins("Together")
    store = new_store()
    cells = TaskQueue(
        [queue_cell(one, store, Limits()) for one in planned_cells(reference, 10)], store.claims, most_complete=2
    )

    def fit() -> bool:
        taken = cells.take(None)
        if taken is not None:
            cells.add(taken[0], [Scored(Row(0, Status.OK))], 1.0, True)
        return taken is not None

    with ThreadPoolExecutor(1) as thread:
        assert [fit(), fit()] == [True, True]
        third = thread.submit(fit)
        time.sleep(3 * pool.WAIT_S)
        assert not third.done()
        assert len(list(store.claims.iterdir())) == 2
        complete = cells.complete.get_nowait()
        assert complete is not None
        cells.close(complete)
        assert third.result(timeout=60)
        assert len(list(store.claims.iterdir())) == 2
        cells.stop()
    cells.claims.release_all()


def test_a_run_that_waits_for_another_says_once_for_whom(
    reference: Scenario, plugins: Plugins, new_store: StoreFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    plugins("Together")
    monkeypatch.setattr(pool, "WAIT_S", 0.01)
    monkeypatch.setattr(pool, "PATIENCE_S", 0.05)
    store = new_store()
    planned = planned_cells(reference, 2)
    other = Claims(store.claims)
    assert all(other.take(one.cell.identity) for one in planned)
    cells = TaskQueue([queue_cell(one, store, Limits()) for one in planned], store.claims)
    with ThreadPoolExecutor(1) as thread:
        waiting = thread.submit(cells.take, None)
        said = cells.events.get(timeout=60)
        holder = other.holder(planned[0].cell.identity)
        assert said == f"waiting for another run on this store (cells left: 2): {holder}"
        assert str(os.getpid()) in holder
        time.sleep(0.3)
        assert cells.events.empty()
        other.release_all()
        assert waiting.result(timeout=60) is not None
    cells.claims.release_all()


@pytest.mark.parametrize("state", [State.MISSING, State.STALE])
def test_what_another_run_has_stored_since_the_plan_is_not_computed_again(
    reference: Scenario, plugins: Plugins, new_store: StoreFactory, state: State
) -> None:
    """However long a run takes from its plan to its first fit: bounds come in between."""
    plugins("Together")
    store, cell = new_store(), a_cell(reference)
    before = 0
    if state is State.STALE:
        rows_of(store, cell)
        before = store.stamp(cell.identity)
    planned = [Planned(cell, state, "", True, before)]
    rows_of(store, cell) if state is State.MISSING else store.save(loaded(store, cell))
    stamp = store.stamp(cell.identity)
    assert stamp != before
    run_cells(planned, store, Limits(1, 30.0, 1000.0))
    assert store.stamp(cell.identity) == stamp


@pytest.mark.parametrize("n", [1, 60], ids=["read one by one", "from the view of all"])
def test_a_plan_says_when_it_saw_a_cell_stored(
    reference: Scenario, plugins: Plugins, new_store: StoreFactory, n: int
) -> None:
    plugins("Together")
    store, cell = new_store(), a_cell(reference)
    rows_of(store, cell)
    others = [one.cell for one in planned_cells(reference, n)]
    first, *rest = plan([cell, *others], store)
    assert first.stamp == store.stamp(cell.identity) > 0
    assert {one.stamp for one in rest} == {0}


def loaded(store: Store, cell: Cell) -> StoredCell:
    stored = store.load(cell.identity)
    assert stored is not None
    return stored
