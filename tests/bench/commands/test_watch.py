"""Watching a sweep: finished, without a run, and with a run in another process."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import StoreFactory, a_cell, computed

from bench.commands.main import main
from bench.commands.watch import NO_RUN
from bench.engine.pool import Limits
from bench.scenario.scenario import Scenario
from bench.store.cell import Cell
from bench.store.locks import Claims, active_claims
from bench.store.store import Store

SWEEP = ["method=prior,oracle,ls", "replicates=2,3,4,5"]


@pytest.fixture
def store(reference: Scenario, store: Store) -> Store:
    """Return a store with a finished cell, and one whose fits all failed."""
    computed(store, a_cell(reference, "prior"))
    computed(store, Cell(reference, "ls", {}, 2, 0, "ls"), limits=Limits(1, timeout_s=1e-6))
    return store


def test_only_locked_claims_count(tmp_path: Path) -> None:
    """A killed run leaves its claim as a file without a lock."""
    claims = Claims(tmp_path)
    assert active_claims(tmp_path / "nowhere") == {}
    assert claims.take("locked")
    assert claims.take("released")
    claims.release("released")
    take = f"Claims(Path({str(tmp_path)!r})).take('killed')"
    script = f"from bench.store.locks import Claims\nfrom pathlib import Path\n{take}\n"
    kill = "import os, signal\nos.kill(os.getpid(), signal.SIGKILL)\n"
    done = subprocess.run([sys.executable, "-c", script + kill], timeout=120)
    assert done.returncode == -signal.SIGKILL
    assert (tmp_path / "killed.claim").exists()
    assert set(active_claims(tmp_path)) == {"locked"}
    assert Claims(tmp_path).take("killed")


def test_watching_a_finished_sweep_ends_at_once_and_counts_failures(
    store: Store, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["status", "method=prior,ls", "replicates=2", f"store={store.folder}", "watch=3600"]) == 0
    assert "2/2 cells, 2 failed, 4/4 fits" in capsys.readouterr().err


def test_a_running_sweep_is_watched_to_its_end(new_store: StoreFactory) -> None:
    """One process computes a sweep, another watches it and ends with it."""
    bench, fields = [sys.executable, "-m", "bench"], [*SWEEP, f"store={new_store().folder}"]
    sweep = subprocess.Popen([*bench, "-m", *fields, "workers=1"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        watching = [*bench, "status", *fields, "watch=0.2"]
        done = subprocess.run(watching, capture_output=True, text=True, timeout=240)
    finally:
        assert sweep.wait(240) == 0
    assert (done.returncode, done.stdout) == (0, "")
    assert "12/12 cells, 42/42 fits" in done.stderr.splitlines()[-1]


def test_ctrl_c_ends_watching_a_sweep_without_a_run(new_store: StoreFactory) -> None:
    watching = [sys.executable, "-m", "bench", "status", *SWEEP, f"store={new_store().folder}", "watch=30"]
    process = subprocess.Popen(watching, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    assert process.stderr.readline().strip() == f"bench: {NO_RUN}"
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=120)
    assert (process.returncode, err.strip()) == (130, "bench: interrupted")
