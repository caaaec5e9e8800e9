"""Tasks of the pool: computed once, ended within their limits, and none lost or computed twice by drivers that die."""

from __future__ import annotations

import os
import secrets
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import psutil
import pytest

from bench.engine.pool import Limits, run_tasks
from bench.engine.progress import Kind, RunState
from bench.store.results import read_result, result_path, write_result

HERE = Path(__file__).parent


@dataclass(frozen=True)
class Deed:
    """A task that leaves a mark each time it is performed, and may go wrong."""

    key: str
    what: str = "good"
    limit_s: float = 60.0
    size: int = 1

    @property
    def kind(self) -> Kind:
        return self.what, ""

    def stored(self, folder: Path) -> bool:
        return read_result(folder, self.key) is not None

    def compute(self, folder: Path) -> None:
        (folder / f"{self.key}.{os.getpid()}.{time.time_ns()}.mark").touch()
        if self.what == "raise":
            raise ValueError("two lines\nof reasons")
        if self.what == "die":
            os.kill(os.getpid(), signal.SIGKILL)
        if self.what == "hang":
            process = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"], start_new_session=True)
            (folder / "grandchild").write_text(str(process.pid))
            time.sleep(600)
        if self.what == "slow":
            time.sleep(0.05)
        write_result(folder, self.key, self.key.encode())


def marks(folder: Path) -> list[str]:
    return sorted(path.name.partition(".")[0] for path in folder.glob("*.mark"))


def test_what_is_stored_is_not_computed_again_and_what_fails_harms_no_other(tmp_path: Path) -> None:
    deeds = [Deed("a"), Deed("b", "raise"), Deed("c", "die"), Deed("d")]
    looks: list[RunState] = []
    errors = run_tasks(deeds, tmp_path, Limits(), ("deed", ""), looks.append)
    assert errors == {"b": "ValueError: two lines of reasons", "c": "the process was ended by SIGKILL"}
    assert [deed.key for deed in deeds if deed.stored(tmp_path)] == ["a", "d"]
    assert (looks[-1].done, looks[-1].total, looks[-1].note) == (4, 4, "2 failed")
    run_tasks(deeds, tmp_path, Limits(), ("deed", ""))
    assert marks(tmp_path) == ["a", "b", "b", "c", "c", "d"]


@pytest.mark.slow
def test_a_task_that_hangs_ends_within_its_limit_with_all_that_it_started(tmp_path: Path) -> None:
    errors = run_tasks([Deed("a", "hang", limit_s=2.0), Deed("b")], tmp_path, Limits(), ("deed", ""))
    assert errors == {"a": "stopped after the limit of 2 s"}
    pid = int((tmp_path / "grandchild").read_text())
    assert not psutil.pid_exists(pid) or psutil.Process(pid).status() == psutil.STATUS_ZOMBIE
    assert Deed("b").stored(tmp_path)


DRIVER = """
import sys
from pathlib import Path
from bench.engine.pool import Limits, run_tasks
sys.path.insert(0, sys.argv[1])
from test_pool import Deed
run_tasks([Deed(f"{i:02d}", "slow") for i in range(60)], Path(sys.argv[2]), Limits(2), ("deed", ""))
"""


@pytest.mark.slow
@pytest.mark.parametrize("kills", [2, 10])
def test_a_driver_that_is_killed_loses_nothing_and_repeats_only_what_was_under_way(tmp_path: Path, kills: int) -> None:
    command = [sys.executable, "-c", DRIVER, str(HERE), str(tmp_path)]
    for n in range(kills):
        with subprocess.Popen(command, stderr=subprocess.DEVNULL) as driver:
            until = time.monotonic() + 60.0
            while len(list(tmp_path.glob("*.result"))) <= 4 * n and driver.poll() is None and time.monotonic() < until:
                time.sleep(0.01)
            driver.kill()
    before = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.result")}
    assert kills <= len(before) < 60
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert len(list(tmp_path.glob("*.result"))) == 60
    assert all(path.stat().st_mtime_ns == written for path, written in before.items())
    assert len(marks(tmp_path)) <= 60 + 2 * kills  # each driver had at most two under way


def test_every_flipped_bit_of_a_result_is_noticed(tmp_path: Path) -> None:
    from conftest import damaged  # not above: processes that import this file do not know where that one is

    write_result(tmp_path, "a", secrets.token_bytes(200))
    path = result_path(tmp_path, "a")
    whole = path.read_bytes()
    for _ in damaged([path], 400):
        assert read_result(tmp_path, "a") is None
    for content in (b"", whole + b"\0", whole + whole):
        path.write_bytes(content)
        assert read_result(tmp_path, "a") is None
    path.unlink()
    os.mkfifo(path)
    assert read_result(tmp_path, "a") is None
