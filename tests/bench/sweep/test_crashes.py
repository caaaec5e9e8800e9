"""Methods that crash, hang, grow or are killed, in one sweep with good ones: every cell a row, the good untouched."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import pytest
from conftest import Plugins, StoreFactory

from bench import Status
from bench.engine.pool import Limits
from bench.entrants.registry import default_settings
from bench.isolation.failure import without_places
from bench.scenario.scenario import Scenario
from bench.store.cell import Cell
from bench.store.store import Store
from bench.sweep.plan import FAILURES, State, plan, read_retry
from bench.sweep.runner import run_cells

KINDS = {
    "raise": (Status.CRASHED, "ValueError: two lines of reasons"),
    "system_exit": (Status.CRASHED, "exited with status 1"),
    "exit": (Status.CRASHED, "exited with status 3"),
    "segfault": (Status.KILLED, "SIGSEGV"),
    "kill": (Status.KILLED, "SIGKILL"),
    "memory": (Status.OOM, "out of memory"),
    "huge": (Status.OOM, "out of memory"),
    "grow": (Status.OOM, "memory"),
    "sleep": (Status.TIMEOUT, "limit of 4 s"),
    "hang": (Status.TIMEOUT, "limit of 4 s"),
    "slow_reconstruction": (Status.TIMEOUT, "limit of 4 s"),
    "nan": (Status.NONFINITE, "not finite"),
    "empty": (Status.NONFINITE, "not finite"),
    "type": (Status.CRASHED, "an Estimate was expected"),
    "misshapen": (Status.INVALID, "cannot be scored"),
    "wrong_shape": (Status.INVALID, "cannot be scored"),
    "recursion": (Status.CRASHED, "RecursionError"),
    "close": (Status.CRASHED, "exited with status 1"),
    "unpicklable": (Status.OK, ""),
    "orphan": (Status.OK, ""),
}
LIMITS = Limits(workers=2, timeout_s=4.0, memory_mb=1000.0)
PATIENT = Limits(workers=2, timeout_s=120.0, memory_mb=1000.0)
"""For whatever is to end by itself: a machine that is busy must not make a time-out of it."""
TRACED = {"raise": "two lines", "segfault": "Segmentation fault", "sleep": "in misbehave", "close": "Bad file"}


def a_cell(reference: Scenario, method: str, replicates: int = 1, **settings: Any) -> Cell:
    return Cell(reference, method, {**default_settings(method), **settings}, replicates, 0, method)


def left_behind() -> bool:
    return "left behind" in subprocess.run(["ps", "ax", "-o", "args"], capture_output=True, text=True).stdout


def test_every_kind_of_misbehaviour_is_a_row_and_good_cells_are_as_without_it(
    reference: Scenario, plugins: Plugins, new_store: StoreFactory
) -> None:
    plugins("Wrong", "Draw")
    bad = {kind: a_cell(reference, "wrong", kind=kind) for kind in KINDS}
    good = [a_cell(reference, "draw", 5), a_cell(reference, "prior", 3)]
    store, alone = new_store(), new_store()
    endless = [bad[kind] for kind, (status, _) in KINDS.items() if status is Status.TIMEOUT]
    ending = [cell for cell in bad.values() if cell not in endless]
    run_cells(plan([good[0], *ending], store), store, PATIENT)
    run_cells(plan([*endless, good[1]], store), store, LIMITS)
    run_cells(plan(good, alone), alone, PATIENT)
    for kind, (status, part) in KINDS.items():
        stored = store.load(bad[kind].identity)
        assert stored is not None, kind
        (row,) = stored.rows
        assert (kind, row.status) == (kind, status), row.message
        assert part in row.message, row.message
        assert len(row.message.splitlines()) <= 1
    for kind, part in TRACED.items():
        stored = store.load(bad[kind].identity)
        assert stored is not None, kind
        assert part in stored.tracebacks, kind
    for cell in good:
        mixed, pure = store.load(cell.identity), alone.load(cell.identity)
        assert mixed is not None
        assert pure is not None
        assert [(r.message, r.scores, r.data) for r in mixed.rows] == [(r.message, r.scores, r.data) for r in pure.rows]
        assert mixed.tracebacks == ""
    assert not left_behind(), "what a method starts ends with it"


@pytest.fixture
def once_killed(reference: Scenario, plugins: Plugins, new_store: StoreFactory, tmp_path: Path) -> tuple[Store, Cell]:
    """A stored cell of 20 replicates, of which one was killed, until ``tmp_path`` has a file ``mended``."""
    plugins("Sometimes")
    store = new_store()
    cell = a_cell(reference, "sometimes", 20, folder=str(tmp_path))
    run_cells(plan([cell], store), store, Limits(1, 30.0, 1000.0))
    return store, cell


def test_one_bad_replicate_does_not_cost_the_others_of_its_cell(once_killed: tuple[Store, Cell]) -> None:
    """Replicates are handed out together; where the process dies they are tried again, one by one."""
    store, cell = once_killed
    stored = store.load(cell.identity)
    assert stored is not None
    statuses = [row.status for row in stored.rows]
    assert statuses.count(Status.KILLED) == 1
    assert statuses.count(Status.OK) == 19
    assert [row.replicate for row in stored.rows] == list(range(20))


def test_retry_computes_what_failed_and_keeps_the_rest(once_killed: tuple[Store, Cell], tmp_path: Path) -> None:
    store, cell = once_killed
    (kept,) = plan([cell], store)
    assert (kept.state, kept.run) == (State.FAILED, False)
    assert kept.why == "1 of 20 killed"
    before = store.load(cell.identity)
    (tmp_path / "mended").touch()
    (again,) = plan([cell], store, read_retry("failed"))
    assert again.run
    run_cells([again], store, Limits(1, 30.0, 1000.0))
    after = store.load(cell.identity)
    assert before is not None
    assert after is not None
    assert after.n_ok == 20
    good = [row for row in before.rows if row.status is Status.OK]
    assert [row for row in after.rows if row.replicate in {r.replicate for r in good}] == good
    assert after.tracebacks == ""
    assert plan([cell], store, FAILURES)[0].state is State.DONE


def test_a_fit_that_runs_out_of_time_is_scored_by_its_last_report(
    reference: Scenario, plugins: Plugins, new_store: StoreFactory
) -> None:
    """It reports k/m = c/m = 1 and then 8, which for k/m is the truth; a timeout it stays."""
    plugins("Anytime")
    store = new_store()
    cell = a_cell(reference, "anytime")
    run_cells(plan([cell], store), store, LIMITS)
    stored = store.load(cell.identity)
    assert stored is not None
    (row,) = stored.rows
    assert row.status is Status.TIMEOUT
    assert row.scores["k_over_m_ratio"] == pytest.approx(1.0, abs=0.05)  # combined with the prior
    assert stored.n_ok == 0
    assert stored.summary["rmse"]["median"] == float("inf")


def test_the_statuses_that_can_be_tried_again() -> None:
    from bench import InputError

    assert read_retry("none") == frozenset()
    assert read_retry("timeout,killed") == {Status.TIMEOUT, Status.KILLED}
    assert Status.UNSUPPORTED not in read_retry("failed")
    with pytest.raises(InputError, match="retry=sometimes: none, failed, or of"):
        read_retry("sometimes")


def test_two_runs_on_one_store_share_the_cells(
    reference: Scenario, plugins: Plugins, new_store: StoreFactory, tmp_path: Path
) -> None:
    """Each computation leaves a mark; two runs at the same time leave one mark a cell."""
    import threading

    plugins("Marks")
    store = new_store()
    cells = [Cell(reference, "marks", {"folder": str(tmp_path)}, 1, seed, "marks") for seed in range(12)]
    plans = [plan(cells, Store(store.folder)) for _ in range(2)]
    runs = [threading.Thread(target=run_cells, args=(one, Store(store.folder), Limits(1))) for one in plans]
    for run in runs:
        run.start()
    for run in runs:
        run.join(120)
    assert len(list(tmp_path.glob("mark-*"))) == 12
    assert {one.state for one in plan(cells, store)} == {State.DONE}


def test_a_traceback_says_nothing_of_where_the_machine_keeps_its_files() -> None:
    text = (
        'File "/home/someone/env/lib/scipy/linalg/_decomp.py", line 594, in eigh\nFile "C:\\a\\methods\\ls.py", line 1'
    )
    assert without_places(text) == 'File "linalg/_decomp.py", line 594, in eigh\nFile "methods\\ls.py", line 1'
