"""From cells to stored rows: paired, the same in every batch, honest about failures, and blind to the truth."""

from __future__ import annotations

import math
import pickle
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import misbehaving
import numpy as np
import pytest
from conftest import ONE_WORKER, Plugins, StoreFactory, a_cell, computed
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from misbehaving import answer

from bench import Estimate, Normal, Problem, Status
from bench.engine.cells import CellJob
from bench.engine.method_process import perform
from bench.engine.plan import CellState, Planned, plan
from bench.engine.pool import Limits
from bench.engine.runner import make_bounds
from bench.engine.scoring_process import Scorer
from bench.engine.wire import LONGEST_MESSAGE, pack
from bench.isolation.processes import Children
from bench.scenario.scenario import ForceSpec, Scenario
from bench.store.cell import Cell
from bench.store.store import Store


@pytest.fixture(autouse=True)
def _plugins(plugins: Plugins) -> None:
    plugins("Wrong", "Draw", "Spy", "Needy", "FreeOnly", "Exact", "Sole", "Together")


def test_a_method_never_meets_the_truth(reference: Scenario, store: Store) -> None:
    """The spy searches the bytes it is given and every object in its process, right after the oracle has run."""
    oracle, spied = computed(store, a_cell(reference, "oracle", 4), a_cell(reference, "spy", 4))
    assert (oracle.n_ok, spied.n_ok) == (4, 4)
    assert {row.message for row in spied.rows} == {"given [] alive [] saw Problem"}
    problem, truth = reference.replicates(0, 1)[0]
    object.__setattr__(problem, "name", truth)
    message = misbehaving.Spy().identify(problem, np.random.default_rng(0)).message
    assert "given ['Truth']" in message
    assert "Scenario" in message.partition("alive")[2]


def test_values_without_uncertainty_are_not_judged_by_intervals(reference: Scenario, store: Store) -> None:
    """The prior's step, which gives them a scale, makes no distribution of them."""
    stated, alone = computed(store, a_cell(reference, "exact", 2), a_cell(reference, "sole", 2))
    assert "k_over_m_coverage_95" in stated.rows[0].scores
    assert not [name for name in alone.rows[0].scores if "coverage" in name or "pit" in name or "crps" in name]
    assert alone.rows[0].scores["k_over_m_error_pct"] == pytest.approx(12.5, abs=0.1)


def test_a_problem_that_a_method_cannot_take_is_unsupported_with_a_sentence(
    reference: Scenario, store: Store, any_bound: None
) -> None:
    (cell,) = computed(store, a_cell(replace(reference, force=ForceSpec(1.0, 0.1, 1.0)), "freeonly", 2))
    assert cell.status is Status.UNSUPPORTED
    assert {row.message for row in cell.rows} == {"it cannot use a known force"}


def test_a_missing_package_is_a_row_with_the_install_line_and_runs_once_it_is_there(
    reference: Scenario, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell = a_cell(reference, "needy", 2)
    (stored,) = computed(store, cell)
    assert stored.status is Status.MISSING_DEPENDENCY
    assert "pip install 'vibration-bench[needy]'" in stored.rows[0].message
    monkeypatch.setattr(misbehaving.Needy, "requires", ())
    (now,) = computed(store, cell)
    assert now.status is Status.CRASHED  # it ran: its worker still finds nothing to do but raise


def test_rows_are_the_same_however_many_workers_there_are(reference: Scenario, store: Store, tmp_path: Path) -> None:
    """A replicate's random stream hangs on scenario, seed, method and number, not on who computes it, or when."""
    other = Store(tmp_path / "other")
    other.prepare()
    shutil.copytree(store.bounds, other.bounds)
    (alone,) = computed(store, a_cell(reference, "draw", 9), limits=ONE_WORKER)
    (shared,) = computed(other, a_cell(reference, "draw", 9))
    for first, second in zip(alone.rows, shared.rows, strict=True):
        assert (first.replicate, first.message, first.scores) == (second.replicate, second.message, second.scores)
    assert len({row.message for row in alone.rows}) == 9
    (longer,) = computed(other, a_cell(reference, "draw", 10))
    assert [row.message for row in longer.rows[:9]] == [row.message for row in alone.rows]


def test_the_oracle_attains_the_bound(reference: Scenario, store: Store) -> None:
    """Root mean square over bound is near 1; with 40 replicates its standard error is 1/√80 = 0.11, so 4 of them."""
    (cell,) = computed(store, a_cell(reference, "oracle", 40))
    assert cell.n_ok == 40
    for metric in ("k_over_m_error_pct", "c_over_m_error_pct", "m_error_pct"):
        assert cell.summary[metric]["excess"] == pytest.approx(1.0, abs=0.45), metric
    assert cell.summary["k_over_m_coverage_95"]["mean"] >= 0.8  # 34 of 40 or fewer has probability 1e-3
    assert cell.prior_share["m"] > 0.99
    assert (cell.identifiable["m"], cell.identifiable["k_over_m"]) == (False, True)


def test_the_prior_row_is_as_good_as_its_width(reference: Scenario, store: Store) -> None:
    """The error of m is that of a weighing of 2 %: a root mean square of 40 such errors is 2 % within 4 · 11 %."""
    prior, oracle = computed(store, a_cell(reference, "prior", 40), a_cell(reference, "oracle", 3))
    errors = np.array([row.scores["m_error_pct"] for row in prior.rows])
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(2.0, rel=0.45)
    coverage = [prior.summary[f"m_coverage_{level}"]["mean"] for level in (50, 80, 95)]
    assert coverage == pytest.approx([0.50, 0.80, 0.95], abs=0.3)
    realised = [[row.scores["realised_snr_db"] for row in cell.rows] for cell in (prior, oracle)]
    assert realised[0] == pytest.approx([20.0] * 40, abs=6.0)
    assert realised[0][:3] == realised[1], "every method sees the same data"
    assert (prior.cell["method"], prior.cell["data"]["parameters"]) == ("prior", {"m": 1.0, "c": 0.4, "k": 8.0})
    assert prior.cell["sigma"] == pytest.approx(reference.sigmas(0).tolist())
    assert {"python", "packages", "cores", "commit", "dirty", "started", "limits", "data"} <= set(prior.provenance)


def test_scores_depend_neither_on_company_nor_on_a_second_try(reference: Scenario, new_store: StoreFactory) -> None:
    few, eight, every = (computed(new_store(), a_cell(reference, "together", 20, batch=n))[0].rows for n in (1, 8, 100))
    assert [row.message for row in eight] == ["8"] * 16 + ["4"] * 4
    assert {row.message for row in every} == {"20"}
    assert len({row.scores["k_over_m_error_pct"] for row in few}) == 20
    for rows in (eight, every):
        assert [(row.replicate, row.scores) for row in rows] == [(row.replicate, row.scores) for row in few]
    (failed,) = computed(new_store(), a_cell(reference, "together", 20, batch=20, fails=True))
    assert {row.message for row in failed.rows} == {"1"}  # tried again one by one, with the streams of the first try
    assert [row.scores for row in failed.rows] == [row.scores for row in few]


@pytest.fixture
def absurd(reference: Scenario) -> Scenario:
    """A Duffing oscillator over 10^12 s: there is no memory for the steps of its bound."""
    parameters = {"m": 1.0, "c": 0.4, "k": 8.0, "k3": 4.0}
    return replace(reference, system="duffing", parameters=parameters, duration=1e12, label="duffing")


def test_a_bound_that_cannot_be_computed_costs_the_cells_of_its_scenario(
    reference: Scenario, absurd: Scenario, store: Store
) -> None:
    cells = [a_cell(scenario, "wrong", 2, kind="good") for scenario in (absurd, reference)]
    lost, good = computed(store, *cells)
    assert good.n_ok == 2
    assert {(row.status, row.message.partition(": ")[0]) for row in lost.rows} == {
        (Status.INVALID, "the bound cannot be computed")
    }
    assert lost.summary["rmse"]["median"] == math.inf
    assert [planned.state for planned in plan(cells, store)] == [CellState.FAILED, CellState.DONE]


@pytest.mark.parametrize(("limits", "why"), [((0.0, 4000.0), "limit of 0 s"), ((100.0, 1.0), "memory limit of 1 MB")])
def test_the_limits_of_a_fit_hold_for_a_bound(
    absurd: Scenario, store: Store, limits: tuple[float, float], why: str
) -> None:
    """A process has more than 1 MB before it does anything."""
    cell = a_cell(replace(absurd, duration=10.0), "wrong")
    with Children() as children:
        lost = make_bounds([cell], store, children, Limits(1, *limits))
    assert why in lost[cell.identity]


LONG_TEXT = st.integers(1, 17).map(lambda n: "x\udc80" * 2**n)
ANY_TEXT = st.text(st.characters(exclude_categories=()), max_size=20) | LONG_TEXT
"""Of any character, lone surrogates included, and of up to 2^18 of them."""
ANY_ARRAY = st.lists(st.floats(), max_size=4) | st.lists(st.lists(st.floats(), min_size=2, max_size=2), max_size=2)


@dataclass(frozen=True)
class Said:
    """A fit that answers, or raises, as its fields say; ``mean`` and ``names`` replace those of a good estimate."""

    raised: str | None = None
    message: str = ""
    mean: tuple[float, ...] | None = None
    names: tuple[str, ...] = ("k_over_m", "c_over_m")
    traces: dict[str, Any] = field(default_factory=dict)
    status: Status = Status.OK

    def __call__(self, payloads: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        if self.raised is not None:
            raise type(f"Own{self.raised[:3]}".replace("\0", ""), (Exception,), {})(self.raised)
        (problem,) = payloads
        good = answer(problem)
        mean = good.groups.mean if self.mean is None else np.array(self.mean)  # type: ignore[union-attr]
        groups = Normal(self.names, mean, None, log=False)
        return [Estimate(problem.system, groups=groups, message=self.message, traces=self.traces, status=self.status)]


SAID = st.builds(
    Said,
    raised=st.none() | ANY_TEXT,
    message=ANY_TEXT,
    mean=st.none() | st.lists(st.floats(), max_size=3).map(tuple),
    names=st.just(("k_over_m", "c_over_m")) | st.lists(ANY_TEXT, max_size=3).map(tuple),
    traces=st.dictionaries(ANY_TEXT, ANY_ARRAY, max_size=3),
    status=st.sampled_from(Status),
)


def complete(said: Said, cell: Cell, store: Store) -> CellJob:
    """Return a cell whose one row is there, not yet stored."""
    job, scorer = CellJob(Planned(cell, CellState.MISSING, "", True), store, Limits()), Scorer()
    task = pickle.loads(scorer.open(cell, pickle.dumps(said), job.take(), 600.0))
    job.add(scorer.score(cell, pack((0.0, 0.0, 0.0, perform(task)))))
    return job


@settings(
    max_examples=150, deadline=None, derandomize=False, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(said=SAID)
def test_whatever_a_method_says_is_one_row_that_everybody_can_read(
    said: Said, reference: Scenario, store: Store
) -> None:
    cell = a_cell(reference, "wrong", 1)
    job = complete(said, cell, store)
    assert Scorer().finish(cell, store, job.scored, True, {}, {}) == ""
    stored = Store(store.folder).load(cell.identity)
    assert stored is not None
    (row,) = stored.rows
    assert (row.status is Status.OK) <= (said.raised is None and said.status is Status.OK)
    assert len(row.message.encode()) <= 6 * LONGEST_MESSAGE
    assert len(row.message.splitlines()) <= 1 or said.raised is None
    dict(stored.arrays)  # can be read
    (head,) = store.heads()
    assert (head.problem, head.statuses) == ("", {row.status.value: 1})
