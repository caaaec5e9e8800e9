"""What a dishonest method can do in a sweep: nothing that it finds in its process is the truth, or changes a score."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import misbehaving
import numpy as np
import pytest
from conftest import Plugins, Python, StoreFactory

from bench import Status
from bench.engine.plan import plan
from bench.engine.pool import Limits
from bench.engine.runner import run_cells
from bench.entrants.registry import default_settings
from bench.scenario.scenario import METHOD, NOMINAL, Scenario
from bench.scoring.row import Row
from bench.store.cell import Cell
from bench.store.store import Store

TRUE = {"k_over_m": 8.0, "c_over_m": 0.4}
"""Of the reference system (1/s², 1/s)."""


@pytest.fixture
def store(new_store: StoreFactory) -> Store:
    return new_store()


def rows(store: Store, scenario: Scenario, method: str, replicates: int = 3, **settings: Any) -> Sequence[Row]:
    cell = Cell(scenario, method, {**default_settings(method), **settings}, replicates, 0, method)
    run_cells(plan([cell], store), store, Limits(1, 60.0, 2000.0))
    stored = store.load(cell.identity)
    assert stored is not None
    return stored.rows


def test_a_method_cannot_draw_the_nominal_values_again(reference: Scenario, store: Store, plugins: Plugins) -> None:
    """With numpy's own stream of the same numbers it has the truth; in a sweep its answer is the nominal values."""
    assert misbehaving.NOMINAL == NOMINAL
    problem, _ = reference.replicates(0, 3)[2]
    leaking = np.random.default_rng(np.random.SeedSequence(0, spawn_key=(METHOD, *reference._key, 2)))
    answer = misbehaving.Redraw().identify(problem, leaking).groups
    assert answer is not None
    assert answer.values() == pytest.approx(TRUE, rel=1e-12)
    plugins("Redraw")
    found = rows(store, reference, "redraw")
    nominal = [make[0].prior for make in reference.replicates(0, 3)]
    for row, prior in zip(found, nominal, strict=True):
        assert prior is not None
        expected = 100 * abs(prior.nominal["k"] / prior.nominal["m"] / TRUE["k_over_m"] - 1)
        assert row.scores["k_over_m_error_pct"] == pytest.approx(expected, rel=1e-3)
        assert expected > 1.0


@pytest.mark.parametrize("of", ["time", "bench.engine.method_process"])
def test_a_clock_that_a_method_replaces_changes_no_time(
    reference: Scenario, store: Store, plugins: Plugins, of: str
) -> None:
    """It sleeps for 0.1 s, and has processor time too: only what runs elsewhere can be trusted to say so."""
    plugins("Clock")
    for row in rows(store, reference, "clock", of=of):
        assert row.status is Status.OK, row.message
        assert row.wall_s >= 0.09
        assert 0.0 <= row.cpu_s < row.wall_s


def test_no_true_parameter_stands_in_a_process_that_a_method_can_read(
    python: Python, new_store: StoreFactory, tmp_path: Path
) -> None:
    """It reads its arguments, and the command lines, variables and open files of itself and of all above it."""
    info = tmp_path / "site" / "double-1.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: double\nVersion: 1\n")
    (info / "entry_points.txt").write_text("[bench.methods]\nancestors = misbehaving:Ancestors\n")
    path = os.pathsep.join([str(info.parent), str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    store = new_store()
    fields = ("system.parameters.k=7.31251", "method.number=7.31251", "replicates=1", "workers=1")
    done = python("-m", "bench", "method=ancestors", *fields, f"store={store.folder}", env={"PYTHONPATH": path})
    assert done.returncode == 0, done.stderr
    (stored,) = (store.load(identity) for identity in store.identities())
    assert stored is not None
    assert [(row.status, row.message) for row in stored.rows] == [(Status.OK, "[]")]


def test_neighbours_that_a_method_has_stopped_go_on(reference: Scenario, store: Store, plugins: Plugins) -> None:
    """It stops all children of its server, the server, and the server's group; every row is as without it."""
    plugins("Wrong", "Draw")
    cells = [
        Cell(reference, "wrong", {"kind": "stop_neighbours"}, 4, 0, "wrong"),
        Cell(reference, "draw", {}, 40, 0, ""),
    ]
    run_cells(plan(cells, store), store, Limits(2, 60.0, 2000.0))
    for cell in cells:
        stored = store.load(cell.identity)
        assert stored is not None
        assert {row.status for row in stored.rows} == {Status.OK}
