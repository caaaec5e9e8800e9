"""Whatever a method says or raises, and whatever is raised while its cell is finished, is a stored row of that cell."""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from conftest import Plugins, StoreFactory
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from misbehaving import answer

from bench import Estimate, Normal, Problem, Status
from bench.engine.pool import Limits
from bench.entrants.registry import default_settings
from bench.isolation.failure import LONGEST, one_line, printable
from bench.isolation.processes import Died
from bench.scenario.scenario import Scenario
from bench.store.cell import Cell
from bench.store.store import Store
from bench.sweep import cells as cells_of_a_run
from bench.sweep.cells import QueuedCell, ScoringError, queue_cell
from bench.sweep.method_process import perform
from bench.sweep.plan import Planned, State, plan
from bench.sweep.runner import run_cells
from bench.sweep.scoring_process import Scorer
from bench.sweep.wire import LONGEST_MESSAGE, pack

LONG_TEXT = st.integers(1, 17).map(lambda n: "x\udc80" * 2**n)
ANY_TEXT = st.text(st.characters(exclude_categories=()), max_size=20) | LONG_TEXT
"""Of any character, lone surrogates included, and of up to 2^18 of them."""
ANY_ARRAY = st.lists(st.floats(), max_size=4) | st.lists(st.lists(st.floats(), min_size=2, max_size=2), max_size=2)


@dataclass(frozen=True)
class Said:
    """A fit that answers, or raises, what it is told; ``changes`` replace fields of a good estimate."""

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


@pytest.fixture
def cell(reference: Scenario, plugins: Plugins) -> Cell:
    plugins("Wrong")
    return Cell(reference, "wrong", default_settings("wrong"), 1, 0, "wrong")


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(said=SAID)
def test_whatever_a_method_says_is_one_row_that_everybody_can_read(
    said: Said, cell: Cell, made: Callable[[], Store]
) -> None:
    store, scorer = made(), Scorer()
    queued = queue_cell(Planned(cell, State.MISSING, "", True), store, Limits())
    task = scorer.open(cell, pickle.dumps(said), (0,), 600.0)
    queued.add(scorer.score(cell, pack(([], 0.0, pack(perform(task))))), 1.0, True)
    problem = scorer.finish(cell, store, queued.rows, queued.arrays, queued.facts, queued.errors(), True, {}, {})
    assert problem == ""
    stored = Store(store.folder).load(cell.identity)
    assert stored is not None
    (row,) = stored.rows
    assert (row.status is Status.OK) <= (said.raised is None and said.status is Status.OK)
    assert len(row.message.encode()) <= 6 * LONGEST_MESSAGE
    dict(stored.arrays)  # can be read
    (head,) = store.heads()
    assert (head.problem, head.statuses) == ("", {row.status.value: 1})


@pytest.fixture
def made(new_store: StoreFactory) -> Callable[[], Store]:
    """One store, which each example writes over."""
    store = new_store()
    return lambda: store


@given(ANY_TEXT)
def test_a_message_is_cut_and_can_be_encoded(text: str) -> None:
    line = one_line(ValueError(text))
    assert line.startswith("ValueError:")
    assert len(line.encode()) <= 4 * LONGEST
    assert len(line.splitlines()) == 1
    assert printable("plain ² Ω\n", 100) == "plain ² Ω\n"
    assert printable("r\udcff", 100) == "r\\udcff"


KINDS = {
    "raise_surrogate": (Status.CRASHED, "FileNotFoundError: no file r\\udcffcord.csv"),
    "raise_long:5": (Status.CRASHED, "ValueError: xxx"),
    "unspeakable": (Status.CRASHED, "Unspeakable: (its message cannot be read)"),
    "message": (Status.OK, "r\\udcffcord xxx"),
    "trace_name": (Status.OK, ""),
}


def test_a_sweep_of_methods_that_say_what_cannot_be_encoded_stores_every_cell(
    reference: Scenario, plugins: Plugins, new_store: StoreFactory
) -> None:
    plugins("Wrong")
    store = new_store()
    cells = {kind: Cell(reference, "wrong", {"kind": kind}, 1, 0, "wrong") for kind in KINDS}
    run_cells(plan(list(cells.values()), store), store, Limits(2, 60.0, 1000.0))
    for kind, (status, part) in KINDS.items():
        stored = store.load(cells[kind].identity)
        assert stored is not None, kind
        assert (stored.rows[0].status, stored.rows[0].message[: len(part)]) == (status, part)


@pytest.fixture
def complete(cell: Cell, new_store: StoreFactory) -> QueuedCell:
    """A cell whose one row is there."""
    queued = queue_cell(Planned(cell, State.MISSING, "", True), new_store(), Limits())
    assert queued.take() == (0,)
    scorer = Scorer()
    task = scorer.open(cell, pickle.dumps(Said(traces={"loss": [1.0]})), (0,), 600.0)
    queued.add(scorer.score(cell, pack(([], 0.0, pack(perform(task))))), 1.0, True)
    assert queued.complete
    assert queued.rows[0].status is Status.OK
    return queued


class Going:
    """A thread of a run that is not over."""

    def go_on(self) -> None:
        """Raise nothing."""


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[tuple[Any, ...]]]:
    """Have the scoring process raise some errors, and then answer; what it is asked to store."""

    def failing(*errors: Exception) -> list[tuple[Any, ...]]:
        left, requests = list(errors), list[tuple[Any, ...]]()

        def ask(thread: Any, request: str, *arguments: Any, limit_s: float) -> str:
            requests.append(arguments)
            if left:
                raise left.pop()
            return ""

        monkeypatch.setattr(cells_of_a_run, "ask", ask)
        return requests

    return failing


def test_what_is_raised_while_a_cell_is_finished_is_its_row(complete: QueuedCell, asked: Callable[..., Any]) -> None:
    requests = asked(ScoringError("UnicodeEncodeError: surrogates", "Traceback"))
    complete.finish(Going())  # type: ignore[arg-type]
    _, _, (row,), arrays, facts, tracebacks, bounded, *_ = requests[-1]
    assert (row.status, row.scores) == (Status.INVALID, {})
    assert row.message == "it cannot be summarised: UnicodeEncodeError: surrogates"
    assert (arrays, facts, tracebacks, bounded) == ({}, {}, "replicate 0\nTraceback\n", False)


def test_a_process_that_dies_while_a_cell_is_finished_is_asked_again(
    complete: QueuedCell, asked: Callable[..., Any]
) -> None:
    died = Died("killed", "ended by SIGKILL", "")
    requests = asked(died, died)
    complete.finish(Going())  # type: ignore[arg-type]
    assert [arguments[2][0].status for arguments in requests] == [Status.OK] * 3


def test_a_cell_without_a_bound_is_stored(cell: Cell, new_store: StoreFactory) -> None:
    store = new_store()
    queued = queue_cell(
        Planned(cell, State.MISSING, "", True), store, Limits(), unbounded="its bound cannot be computed: x"
    )
    assert not queued.open
    Scorer().finish(cell, store, queued.rows, {}, {}, "", queued.bounded, {}, {})
    stored = store.load(cell.identity)
    assert stored is not None
    assert [(row.status, row.message) for row in stored.rows] == [(Status.INVALID, "its bound cannot be computed: x")]
    assert stored.summary["rmse"]["median"] == math.inf
    assert stored.prior_share == {}
