"""What a dishonest method can do in a sweep: nothing that it finds in its process is the truth, or changes a score."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import misbehaving
import numpy as np
import pytest
from conftest import Plugins, StoreFactory

from bench.entrants.registry import default_settings
from bench.scenario.scenario import METHOD, NOMINAL, Scenario
from bench.scoring.row import Row
from bench.store.cell import Cell
from bench.store.store import Store
from bench.sweep.plan import plan
from bench.sweep.runner import run_cells
from bench.sweep.workers import Limits

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
