"""What a dishonest method can do in a sweep: nothing that it finds in its process is the truth, or changes a score."""

from __future__ import annotations

import os
from pathlib import Path

import misbehaving
import numpy as np
import pytest
from conftest import ONE_WORKER, Plugins, Python, StoreFactory, a_cell, computed, install

from bench import Status
from bench.scenario.scenario import METHOD, NOMINAL, Scenario
from bench.store.store import Store

TRUE = {"k_over_m": 8.0, "c_over_m": 0.4}
"""Of the reference system (1/s², 1/s)."""


def test_a_method_cannot_draw_the_nominal_values_again(reference: Scenario, store: Store, plugins: Plugins) -> None:
    """With numpy's own stream of the same numbers it has the truth; in a sweep its answer is the nominal values."""
    assert misbehaving.NOMINAL == NOMINAL
    problem, _ = reference.replicates(0, 3)[2]
    leaking = np.random.default_rng(np.random.SeedSequence(0, spawn_key=(METHOD, *reference._key, 2)))
    answer = misbehaving.Redraw().identify(problem, leaking).groups
    assert answer.values() == pytest.approx(TRUE, rel=1e-12)
    plugins("Redraw")
    (stored,) = computed(store, a_cell(reference, "redraw", 3))
    nominal = [make[0].prior for make in reference.replicates(0, 3)]
    for row, prior in zip(stored.rows, nominal, strict=True):
        expected = 100 * abs(prior.nominal["k"] / prior.nominal["m"] / TRUE["k_over_m"] - 1)
        assert row.scores["k_over_m_error_pct"] == pytest.approx(expected, rel=1e-3)
        assert expected > 1.0


@pytest.mark.parametrize("of", ["time", "bench.engine.method_process"])
def test_a_clock_that_a_method_replaces_changes_no_time(
    reference: Scenario, store: Store, plugins: Plugins, of: str
) -> None:
    """It sleeps for 0.1 s, and has processor time too: only what runs elsewhere can be trusted to say so."""
    plugins("Clock")
    for row in computed(store, a_cell(reference, "clock", 3, of=of), limits=ONE_WORKER)[0].rows:
        assert row.status is Status.OK, row.message
        assert row.wall_s >= 0.09
        assert 0.0 <= row.cpu_s < row.wall_s


def test_no_true_parameter_stands_in_a_process_that_a_method_can_read(
    python: Python, new_store: StoreFactory, tmp_path: Path
) -> None:
    """It reads its arguments, and the command lines, variables and open files of itself and of all above it."""
    env = install(tmp_path / "site", "double", "[bench.methods]\nancestors = misbehaving:Ancestors\n")
    env["PYTHONPATH"] += f"{os.pathsep}{Path(__file__).parent}"
    store = new_store()
    fields = ("system.parameters.k=7.31251", "method.number=7.31251", "replicates=1", "workers=1")
    done = python("-m", "bench", "method=ancestors", *fields, f"store={store.folder}", env=env)
    assert done.returncode == 0, done.stderr
    (stored,) = (store.load(identity) for identity in store.identities())
    assert [(row.status, row.message) for row in stored.rows] == [(Status.OK, "[]")]


def test_neighbours_that_a_method_has_stopped_go_on(reference: Scenario, store: Store, plugins: Plugins) -> None:
    """It stops all children of its server, the server, and the server's group; every row is as without it."""
    plugins("Wrong", "Draw")
    cells = [a_cell(reference, "wrong", 4, kind="stop_neighbours"), a_cell(reference, "draw", 40)]
    for stored in computed(store, *cells):
        assert {row.status for row in stored.rows} == {Status.OK}
