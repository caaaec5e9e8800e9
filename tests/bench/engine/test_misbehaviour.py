"""Methods that crash, hang, grow, flood or attack: a row each, good cells beside them untouched, and nothing stays."""

from __future__ import annotations

import subprocess
from pathlib import Path

import psutil
import pytest
from conftest import Plugins, StoreFactory, a_cell, computed

from bench import Status
from bench.engine.plan import plan
from bench.engine.pool import Limits
from bench.engine.runner import run_cells
from bench.isolation.failure import without_folders
from bench.isolation.limits import LONGEST_FILE
from bench.scenario.scenario import Scenario
from bench.store.store import Store

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
    "half_message": (Status.TIMEOUT, "limit of 4 s"),
    "slow_reconstruction": (Status.TIMEOUT, "limit of 4 s"),
    "nan": (Status.NONFINITE, "not finite"),
    "empty": (Status.NONFINITE, "not finite"),
    "type": (Status.CRASHED, "an Estimate was expected"),
    "misshapen": (Status.INVALID, "an array must have shape (2), not (3,)"),
    "wrong_shape": (Status.INVALID, "a reconstruction must have shape (1, 1000), not (3,)"),
    "raising_reconstruction": (Status.INVALID, "ValueError: no reconstruction here"),
    "recursion": (Status.CRASHED, "RecursionError"),
    "close": (Status.CRASHED, "exited with status 1"),
    "raise_surrogate": (Status.CRASHED, "FileNotFoundError: no file r\\udcffcord.csv"),
    "raise_long:8": (Status.CRASHED, "ValueError: xxx"),
    "unspeakable": (Status.CRASHED, "Unspeakable: (its message cannot be read)"),
    "trace:7": (Status.INVALID, "its size of 76 MB exceeds the limit of 64 MB"),
    "chatter:8": (Status.CRASHED, f"printed, or wrote to a file, more than {LONGEST_FILE >> 20} MB"),
    "message": (Status.OK, "r\\udcffcord xxx"),
    "trace_name": (Status.OK, ""),
    "unpicklable": (Status.OK, ""),
    "orphan": (Status.OK, ""),
}
LIMITS = Limits(workers=2, timeout_s=4.0, memory_mb=1500.0)
PATIENT = Limits(workers=2, timeout_s=120.0, memory_mb=1500.0)
"""For whatever is to end by itself: a machine that is busy must not make a time-out of it."""
TRACED = {"raise": "two lines", "segfault": "Segmentation fault", "sleep": "in misbehave", "close": "Bad file"}


@pytest.fixture
def store(plugins: Plugins, new_store: StoreFactory) -> Store:
    plugins("Wrong", "Draw", "Anytime")
    return new_store()


def left_behind() -> bool:
    return "left behind" in subprocess.run(["ps", "ax", "-o", "args"], capture_output=True, text=True).stdout


@pytest.mark.slow
def test_every_kind_of_misbehaviour_is_a_row_and_good_cells_are_as_without_it(
    reference: Scenario, store: Store, new_store: StoreFactory
) -> None:
    bad = {kind: a_cell(reference, "wrong", 1, kind=kind) for kind in KINDS}
    good, alone = [a_cell(reference, "draw", 5), a_cell(reference, "prior", 3)], new_store()
    endless = [bad[kind] for kind, (status, _) in KINDS.items() if status is Status.TIMEOUT]
    ending = [cell for cell in bad.values() if cell not in endless]
    run_cells(plan([good[0], *ending], store), store, PATIENT)
    run_cells(plan([*endless, good[1]], store), store, LIMITS)
    for kind, (status, part) in KINDS.items():
        stored = store.load(bad[kind].identity)
        assert stored is not None, kind
        (row,) = stored.rows
        assert (kind, row.status) == (kind, status), row.message
        assert part in row.message, row.message
        assert len(row.message.splitlines()) <= 1
        assert TRACED.get(kind, "") in stored.tracebacks, kind
    for pure in computed(alone, *good, limits=PATIENT):
        mixed = store.load(pure.identity)
        assert mixed is not None
        assert [(r.message, r.scores, r.data) for r in mixed.rows] == [(r.message, r.scores, r.data) for r in pure.rows]
    assert not left_behind(), "what a method starts ends with it"


def outcomes(reference: Scenario, store: Store, *kinds: str) -> list[tuple[Status, str]]:
    cells = [a_cell(reference, "wrong", 1, seed=seed, kind=kind) for seed, kind in enumerate(kinds)]
    rows = [stored.rows[0] for stored in computed(store, *cells, limits=Limits(1, 120.0, 1500.0))]
    return [(row.status, row.message) for row in rows]


@pytest.mark.parametrize(
    ("kind", "outcome"),
    [("daemon", (Status.OK, "")), ("daemon_alone", (Status.CRASHED, "the process exited with status 0"))],
)
def test_a_daemon_ends_with_its_fit_and_holds_nobody_up(
    reference: Scenario, store: Store, tmp_path: Path, any_bound: None, kind: str, outcome: tuple[Status, str]
) -> None:
    """It is in a session of its own, without a parent, and holds the connection of the process that has left it."""
    pid_file = tmp_path / "pid"
    assert outcomes(reference, store, f"{kind}:{pid_file}", "good") == [outcome, (Status.OK, "")]
    pid = int(pid_file.read_text())
    assert not psutil.pid_exists(pid) or psutil.Process(pid).status() == psutil.STATUS_ZOMBIE


@pytest.mark.parametrize("kind", ["stop_server", "kill_server"])
def test_a_method_that_attacks_the_server_of_processes_costs_nobody_anything(
    reference: Scenario, store: Store, any_bound: None, kind: str
) -> None:
    assert outcomes(reference, store, kind, "good", "good") == [(Status.OK, "")] * 3


@pytest.mark.slow
def test_a_fit_that_runs_out_of_time_is_scored_by_its_last_report(reference: Scenario, store: Store) -> None:
    """It reports k/m = c/m = 1 and then 8, which for k/m is the truth; a timeout it stays."""
    (stored,) = computed(store, a_cell(reference, "anytime", 1), limits=LIMITS)
    (row,) = stored.rows
    assert (row.status, stored.n_ok) == (Status.TIMEOUT, 0)
    assert row.scores["k_over_m_ratio"] == pytest.approx(1.0, abs=0.05)  # combined with the prior
    assert stored.summary["rmse"]["median"] == float("inf")


def test_a_traceback_does_not_name_folders_of_the_machine() -> None:
    text = (
        'File "/home/someone/env/lib/scipy/linalg/_decomp.py", line 594, in eigh\nFile "C:\\a\\methods\\ls.py", line 1'
    )
    assert without_folders(text) == 'File "linalg/_decomp.py", line 594, in eigh\nFile "methods\\ls.py", line 1'
