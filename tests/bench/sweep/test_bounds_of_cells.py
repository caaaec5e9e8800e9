"""A bound that cannot be computed costs the cells of its scenario, and no others."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from conftest import Plugins, StoreFactory

from bench import InputError, Status
from bench.engine.pool import Limits
from bench.isolation.processes import Children
from bench.scenario.scenario import Scenario
from bench.store.bounds import bound_path, load_bounds
from bench.store.cell import Cell
from bench.store.store import Store
from bench.sweep.bounds import make_bounds
from bench.sweep.plan import State, plan
from bench.sweep.runner import run_cells


@pytest.fixture
def store(plugins: Plugins, new_store: StoreFactory) -> Store:
    plugins("Wrong")
    return new_store()


@pytest.fixture
def absurd(reference: Scenario) -> Scenario:
    """A Duffing oscillator over 10^12 s: there is no memory for the steps of its bound."""
    parameters = {"m": 1.0, "c": 0.4, "k": 8.0, "k3": 4.0}
    return replace(reference, system="duffing", parameters=parameters, duration=1e12, label="duffing")


def a_cell(scenario: Scenario, seed: int = 0) -> Cell:
    return Cell(scenario, "wrong", {"kind": "good"}, 2, seed, "wrong")


def test_the_cells_of_such_a_scenario_say_so_and_the_others_are_computed(
    reference: Scenario, absurd: Scenario, store: Store
) -> None:
    cells = [a_cell(absurd), a_cell(reference), a_cell(absurd, seed=1)]
    run_cells(plan(cells, store), store, Limits(1, 100.0, 4000.0))
    lost, good, other = (store.load(cell.identity) for cell in cells)
    assert good is not None
    assert good.n_ok == 2
    for stored in (lost, other):
        assert stored is not None
        assert {row.status for row in stored.rows} == {Status.INVALID}
        assert {row.message.partition(": ")[0] for row in stored.rows} == {"its bound cannot be computed"}
        assert stored.summary["rmse"]["median"] == math.inf
    assert [one.state for one in plan(cells, store)] == [State.FAILED, State.DONE, State.FAILED]


@pytest.mark.parametrize(("limits", "why"), [((0.0, 4000.0), "limit of 0 s"), ((100.0, 1.0), "memory limit of 1 MB")])
def test_the_limits_of_a_fit_hold_for_a_bound(
    absurd: Scenario, store: Store, limits: tuple[float, float], why: str
) -> None:
    """A process has more than 1 MB before it does anything."""
    cell = a_cell(replace(absurd, duration=10.0))
    children = Children()
    try:
        lost = make_bounds([cell], store, children, Limits(1, *limits))
    finally:
        children.close()
    assert list(lost) == [cell.identity]
    assert why in lost[cell.identity]


def test_bounds_are_those_that_are_computed_here(reference: Scenario, store: Store) -> None:
    cells = [a_cell(replace(reference, snr_db=db)) for db in (20.0, 10.0, 5.0)]
    children = Children()
    try:
        assert make_bounds(cells, store, children, Limits()) == {}
    finally:
        children.close()
    kept = load_bounds(cells, store.bounds)
    for cell in cells:
        bound_path(cell, store.bounds).unlink()
    assert load_bounds(cells, store.bounds) == kept


def test_a_store_that_cannot_be_written_is_one_line(reference: Scenario, store: Store) -> None:
    for path in store.bounds.iterdir():
        path.unlink()
    store.bounds.rmdir()
    store.bounds.write_text("no folder")
    children = Children()
    try:
        with pytest.raises(InputError, match="the bounds cannot be written"):
            make_bounds([a_cell(reference)], store, children, Limits())
    finally:
        children.close()
