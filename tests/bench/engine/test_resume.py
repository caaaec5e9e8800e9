"""Runs that go on: what is stored is kept, what is damaged or failed is computed again, and two runs share the rest."""

from __future__ import annotations

import getpass
import os
import platform
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from conftest import Plugins, StoreFactory, a_cell
from stored import resealed

from bench import InputError, Status
from bench.commands.main import main
from bench.config.experiment import expand
from bench.engine import pool
from bench.engine.cells import CellJob
from bench.engine.plan import FAILURES, CellState, Planned, plan, read_retry
from bench.engine.pool import Limits, TaskQueue
from bench.engine.runner import run_cells
from bench.scenario.scenario import Scenario
from bench.store.locks import Claims
from bench.store.store import Store

LIMITS = Limits(1, 60.0, 1000.0)


@pytest.fixture
def store(plugins: Plugins, new_store: StoreFactory) -> Store:
    plugins("Draw", "Sometimes")
    return new_store()


def test_only_what_is_missing_is_computed(reference: Scenario, store: Store, any_bound: None) -> None:
    cells = [a_cell(replace(reference, snr_db=snr), "draw") for snr in (40.0, 20.0, 10.0)]
    run_cells(plan(cells[1:2], store), store, LIMITS)
    first, second, third = plan([*cells, cells[0]], store)  # asked for twice is computed once
    assert [planned.state for planned in (first, second, third)] == [
        CellState.MISSING,
        CellState.DONE,
        CellState.MISSING,
    ]
    assert [planned.run for planned in (first, second, third)] == [True, False, True]
    assert (first.stamp, second.stamp) == (0, store.stamp(cells[1].identity))
    run_cells([first, second, third], store, LIMITS)
    assert store.stamp(cells[1].identity) == second.stamp
    assert len(store.identities()) == 3


@pytest.mark.parametrize("state", [CellState.MISSING, CellState.STALE])
def test_what_another_run_has_stored_since_the_plan_is_not_computed_again(
    reference: Scenario, store: Store, state: CellState
) -> None:
    """However long a run takes from its plan to its first fit: bounds come in between."""
    cell = a_cell(reference, "draw")
    if state is CellState.STALE:
        run_cells(plan([cell], store), store, LIMITS)
    planned = [Planned(cell, state, "", True, store.stamp(cell.identity))]
    store.path(cell.identity).unlink(missing_ok=True)
    run_cells(plan([cell], store), store, LIMITS)
    stamp = store.stamp(cell.identity)
    run_cells(planned, store, LIMITS)
    assert store.stamp(cell.identity) == stamp


def test_a_run_that_waits_for_another_prints_once_for_whom(
    reference: Scenario, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pool, "WAIT_S", 0.01)
    monkeypatch.setattr(pool, "PATIENCE_S", 0.05)
    jobs = [
        CellJob(planned, store, LIMITS) for planned in plan([a_cell(reference, "draw", seed=i) for i in (0, 1)], store)
    ]
    other, tasks, taken = Claims(store.claims), TaskQueue(jobs, store.claims), list[Any]()
    assert all(other.take(job.key) for job in jobs)
    waiting = threading.Thread(target=lambda: taken.append(tasks.take(None)))
    waiting.start()
    line = tasks.events.get(timeout=60)
    assert line == f"waiting for another run on this store (2 cells left): {other.holder(jobs[0].key)}"
    assert line.endswith(f": process {os.getpid()} of {getpass.getuser()} on {platform.node()}")
    waiting.join(0.3)
    assert tasks.events.empty()
    other.release_all()
    waiting.join(60)
    assert taken[0] is not None
    tasks.claims.release_all()


def test_one_bad_replicate_does_not_cost_the_others_and_can_be_tried_again(
    reference: Scenario, store: Store, tmp_path: Path
) -> None:
    """Replicates are handed out together; where the process dies they are tried again, one by one."""
    cell = a_cell(reference, "sometimes", 20, folder=str(tmp_path))
    run_cells(plan([cell], store), store, LIMITS)
    before = store.load(cell.identity)
    assert before is not None
    statuses = [row.status for row in before.rows]
    assert (statuses.count(Status.KILLED), statuses.count(Status.OK)) == (1, 19)
    assert [row.replicate for row in before.rows] == list(range(20))
    (tmp_path / "mended").touch()
    assert not plan([cell], store)[0].run
    run_cells(plan([cell], store, read_retry("failed")), store, LIMITS)
    after = store.load(cell.identity)
    assert after is not None
    assert after.n_ok == 20
    good = [row for row in before.rows if row.status is Status.OK]
    assert [row for row in after.rows if row.replicate in {r.replicate for r in good}] == good
    assert plan([cell], store, FAILURES)[0].state is CellState.DONE


def test_the_statuses_that_can_be_tried_again() -> None:
    assert read_retry("none") == frozenset()
    assert read_retry("timeout,killed") == {Status.TIMEOUT, Status.KILLED}
    assert Status.UNSUPPORTED not in read_retry("failed")
    with pytest.raises(InputError, match="retry=sometimes: use none, failed, or some of"):
        read_retry("sometimes")


def flip(path: Path) -> None:
    """Change a bit in the middle of a file."""
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 16
    path.write_bytes(content)


DAMAGE: dict[str, Callable[[Path], object]] = {
    "cut": lambda path: path.write_bytes(path.read_bytes()[:1000]),
    "flipped": lambda path: flip(path),
    "of another shape": lambda path: path.write_bytes(resealed({"cell": 3})),
    "a pipe": lambda path: os.mkfifo(path.rename(path.with_suffix(".old")).with_suffix(".json")),
    "whole": lambda path: None,
}


def test_damaged_cells_are_named_and_computed_again_when_failures_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store = Store(tmp_path / "rows")
    seeds = ",".join(map(str, range(len(DAMAGE))))
    command = ["-m", "method=prior", f"seed={seeds}", "replicates=2", f"store={store.folder}"]

    def scores(name: str) -> list[object]:
        stored = store.load(name)
        assert stored is not None
        return [(row.status, dict(row.scores), row.data) for row in stored.rows]

    assert main(command) == 0
    cells = [job.cell() for job in expand(command[1:], True)]
    names = [cell.identity for cell in cells]
    before, whole = {name: scores(name) for name in names}, store.path(names[-1]).stat().st_ino
    for name, damage in zip(names, DAMAGE.values(), strict=True):
        damage(store.path(name))
    capsys.readouterr()
    assert main(command) == 2  # as it stands: the first damaged file is named, nothing runs
    (line,) = capsys.readouterr().err.splitlines()
    assert "compute it again with retry=failed" in line
    assert sum(str(store.path(name)) in line for name in names) == 1
    states = [(planned.state, planned.run) for planned in plan(cells, store, FAILURES)]
    assert states == [(CellState.DAMAGED, True)] * (len(DAMAGE) - 1) + [(CellState.DONE, False)]
    assert main([*command, "retry=failed"]) == 0
    assert {name: scores(name) for name in names} == before
    assert store.path(names[-1]).stat().st_ino == whole
