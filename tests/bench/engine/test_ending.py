"""Sweeps that are ended by a signal clear away what they began, and a machine with little to give is enough."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

SLOW = ("-m", "bench", "-m", "method=ls,shooting", "seed=range(0,400)", "replicates=2", "archive=none")


@pytest.fixture
def temporary() -> Iterator[Path]:
    """A folder for a sweep's temporary files, of a name short enough for sockets."""
    with tempfile.TemporaryDirectory(prefix="v", dir="/tmp") as folder:
        yield Path(folder)


def wait_for_cells(store: Path, more_than: int, run: subprocess.Popen[str]) -> None:
    deadline = time.monotonic() + 200
    while len(list(store.glob("*.json"))) <= more_than and run.poll() is None and time.monotonic() < deadline:
        time.sleep(0.05)
    assert len(list(store.glob("*.json"))) > more_than


def started(store: Path, temporary: Path, *more: str, before: str = "") -> subprocess.Popen[str]:
    """Start a sweep, and wait until it has stored its first cell."""
    environment = {**os.environ, "TMPDIR": str(temporary), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, *SLOW, f"store={store}", "workers=1", *more]
    run = subprocess.Popen(
        ["/bin/sh", "-c", f'{before} exec "$@"', "sh", *command], env=environment, stderr=subprocess.PIPE, text=True,
        stdout=subprocess.DEVNULL,
    )  # fmt: skip
    wait_for_cells(store, 0, run)
    assert list(temporary.iterdir())
    return run


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "how"),
    [(signal.SIGTERM, ()), (signal.SIGHUP, ("hydra/launcher=basic", "cells_per_job=100"))],
    ids=["SIGTERM", "SIGHUP of a launcher"],
)
def test_nothing_temporary_stays(tmp_path: Path, temporary: Path, number: signal.Signals, how: tuple[str, ...]) -> None:
    store = tmp_path / "rows"
    with started(store, temporary, *how) as run:
        processes = psutil.Process(run.pid).children(recursive=True)
        assert processes
        run.send_signal(number)
        _, error = run.communicate(timeout=120)
        assert run.returncode == 128 + number
        assert not psutil.wait_procs(processes, timeout=60)[1]
    assert error.splitlines()[-1] == "bench: interrupted; finished cells are kept; the same command continues"
    assert "Traceback" not in error
    assert (list(temporary.iterdir()), list((store / "claims").iterdir())) == ([], [])
    assert not (store / "launches").exists()
    assert list(store.glob("*.json"))


@pytest.mark.slow
def test_under_nohup_a_terminal_that_closes_ends_nothing(tmp_path: Path, temporary: Path) -> None:
    with started(tmp_path / "rows", temporary, before="trap '' HUP;") as run:
        run.send_signal(signal.SIGHUP)
        wait_for_cells(tmp_path / "rows", len(list((tmp_path / "rows").glob("*.json"))) + 1, run)
        run.send_signal(signal.SIGTERM)
        run.communicate(timeout=120)
        assert run.returncode == 128 + signal.SIGTERM
