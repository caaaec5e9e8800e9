"""A sweep that is asked to end by a signal clears away what it has begun, and keeps what is stored."""

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


def started(store: Path, temporary: Path, *more: str, before: str = "") -> subprocess.Popen[str]:
    """A sweep that has stored its first cell, and has temporary files."""
    environment = {**os.environ, "TMPDIR": str(temporary), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, *SLOW, f"store={store}", "workers=1", *more]
    run = subprocess.Popen(
        ["/bin/sh", "-c", f'{before} exec "$@"', "sh", *command], env=environment, stderr=subprocess.PIPE, text=True,
        stdout=subprocess.DEVNULL,
    )  # fmt: skip
    deadline = time.monotonic() + 200
    while not list(store.glob("*.json")) and run.poll() is None and time.monotonic() < deadline:
        time.sleep(0.05)
    assert list(store.glob("*.json"))
    assert list(temporary.iterdir())
    return run


def gone(processes: list[psutil.Process]) -> bool:
    return not psutil.wait_procs(processes, timeout=60)[1]


@pytest.mark.parametrize("how", [(), ("hydra/launcher=basic", "cells_per_job=100")], ids=["local", "launcher"])
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_nothing_temporary_stays(tmp_path: Path, temporary: Path, number: signal.Signals, how: tuple[str, ...]) -> None:
    with started(tmp_path / "rows", temporary, *how) as run:
        processes = psutil.Process(run.pid).children(recursive=True)
        assert processes
        run.send_signal(number)
        _, said = run.communicate(timeout=120)
        assert run.returncode == 128 + number
        assert gone(processes)
    assert said.splitlines()[-1] == "bench: interrupted; finished cells are kept, the same command goes on from here"
    assert "Traceback" not in said
    assert list(temporary.iterdir()) == []
    assert not (tmp_path / "rows" / "launches").exists()
    assert list((tmp_path / "rows" / "claims").iterdir()) == []
    assert list((tmp_path / "rows").glob("*.json"))


def test_under_nohup_a_terminal_that_closes_ends_nothing(tmp_path: Path, temporary: Path) -> None:
    with started(tmp_path / "rows", temporary, before="trap '' HUP;") as run:
        stored = len(list((tmp_path / "rows").glob("*.json")))
        run.send_signal(signal.SIGHUP)
        deadline = time.monotonic() + 100
        while len(list((tmp_path / "rows").glob("*.json"))) <= stored + 1 and time.monotonic() < deadline:
            time.sleep(0.05)
        assert len(list((tmp_path / "rows").glob("*.json"))) > stored + 1
        run.send_signal(signal.SIGTERM)
        run.communicate(timeout=120)
        assert run.returncode == 128 + signal.SIGTERM
