"""Methods that flood, leave daemons behind or attack the server of processes: a row each, and nothing stays."""

from __future__ import annotations

from pathlib import Path

import psutil
import pytest
from conftest import Plugins, StoreFactory

from bench import Status
from bench.engine.pool import Limits
from bench.isolation import processes
from bench.isolation.limit import LONGEST_FILE
from bench.isolation.processes import Children
from bench.scenario.scenario import Scenario
from bench.store.cell import Cell
from bench.store.store import Store
from bench.sweep.plan import plan
from bench.sweep.runner import run_cells

LIMITS = Limits(workers=1, timeout_s=120.0, memory_mb=1500.0)


@pytest.fixture
def store(plugins: Plugins, new_store: StoreFactory) -> Store:
    plugins("Wrong")
    return new_store()


def outcomes(reference: Scenario, store: Store, *kinds: str) -> list[tuple[Status, str]]:
    cells = [Cell(reference, "wrong", {"kind": kind}, 1, seed, "wrong") for seed, kind in enumerate(kinds)]
    run_cells(plan(cells, store), store, LIMITS)
    found = [store.load(cell.identity) for cell in cells]
    return [(stored.rows[0].status, stored.rows[0].message) for stored in found if stored]


@pytest.mark.parametrize(
    ("kind", "outcome"),
    [("daemon", (Status.OK, "")), ("daemon_alone", (Status.CRASHED, "its process exited with status 0"))],
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


@pytest.fixture
def sizes(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The sizes of the logs of a run's processes, at its end."""
    found: list[int] = []
    close = Children.close

    def measured(children: Children) -> None:
        found.extend(path.stat().st_size for path in Path(children.folder.name).glob("*") if path.is_file())
        close(children)

    monkeypatch.setattr(Children, "close", measured)
    return found


def test_a_method_that_prints_without_end_is_stopped_by_its_row(
    reference: Scenario, store: Store, any_bound: None, sizes: list[int]
) -> None:
    flood, good = outcomes(reference, store, "chatter:8", "good")
    assert flood == (Status.CRASHED, f"it printed, or wrote to a file, more than {LONGEST_FILE >> 20} MB")
    assert good == (Status.OK, "")
    assert max(sizes, default=0) <= LONGEST_FILE
    assert sum(sizes) < 2 * LONGEST_FILE


def test_what_is_raised_or_answered_at_any_length_does_not_reach_the_run(
    reference: Scenario, store: Store, any_bound: None
) -> None:
    long, large, good = outcomes(reference, store, "raise_long:8", "trace:7", "good")
    assert long[0] is Status.CRASHED
    assert len(long[1]) <= 300
    assert large == (Status.INVALID, "the estimate cannot be scored: ValueError: 76 MB, of which at most 64 are taken")
    assert good == (Status.OK, "")


def test_a_log_that_has_become_long_is_emptied_before_the_next_request(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "LONGEST_LOG", 1000)
    children = Children()
    try:
        child = children.start(chattering)
        assert child.receive(60.0) == b"done"
        assert child.log_path.stat().st_size == 2000
        child.send(b"more")
        assert child.receive(60.0) == b"done"
        assert child.log_path.stat().st_size == 2000
    finally:
        children.close()


def chattering(connection: object) -> None:
    """Print 2,000 letters each time it is asked."""
    import os

    while True:
        os.write(1, b"x" * 2000)
        connection.send_bytes(b"done")  # type: ignore[attr-defined]
        connection.recv_bytes()  # type: ignore[attr-defined]
