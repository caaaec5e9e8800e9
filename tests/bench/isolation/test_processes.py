"""Child processes: what of the machine is looked at to know their memory, and how they are let go."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from bench.engine import method_process
from bench.isolation.descendants import descendants_of
from bench.isolation.processes import Children

ASLEEP = [sys.executable, "-c", "import sys; sys.stdin.read()"]
NESTED = [sys.executable, "-c", f"import subprocess; subprocess.run({ASLEEP!r})"]


def test_descendants_are_found_whichever_thread_started_them_and_however_deep() -> None:
    starter = subprocess.Popen(ASLEEP, stdin=subprocess.PIPE)
    with starter, ThreadPoolExecutor(1) as pool:
        assert descendants_of(starter.pid) == []
        nested = pool.submit(subprocess.Popen, NESTED, stdin=subprocess.PIPE, stdout=subprocess.PIPE).result()
        with nested:
            found: set[int] = set()
            while len(found) < 3:
                found = set(descendants_of(os.getpid()))
            assert {starter.pid, nested.pid} < found
            assert nested.stdin is not None
            nested.stdin.close()
        assert starter.stdin is not None
        starter.stdin.close()


def test_a_connection_is_closed_once_by_however_many(monkeypatch: pytest.MonkeyPatch) -> None:
    """A number that is closed a second time may by then be another file's."""
    closed: list[int] = []
    with contextlib.closing(Children([])) as children:
        child = children.start(method_process.serve)
        close = child.connection._close

        def slow_close() -> None:
            closed.append(child.connection.fileno())
            time.sleep(0.1)
            close()

        monkeypatch.setattr(child.connection, "_close", slow_close)
        with ThreadPoolExecutor(4) as pool:
            ends = [pool.submit(end) for end in (child.retire, child.kill, child.retire, child.kill)]
        assert [end.exception() for end in ends] == [None] * 4
    assert len(closed) == 1


RESTARTED = """
import sys
from bench.isolation.processes import Children, start_server


def serve(connection):
    connection.send_bytes(repr("colorsys" in sys.modules).encode())


def main():
    start_server()
    for preload in ((), ("colorsys",), ()):
        children = Children(preload)
        print(children.start(serve).receive(60.0).decode())
        children.close()
"""


def test_a_server_that_lacks_a_package_is_started_again(tmp_path: Path) -> None:
    """A command starts it before it knows which method it runs."""
    (tmp_path / "restarted.py").write_text(RESTARTED)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    command = [sys.executable, "-c", "import restarted; restarted.main()"]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=120, cwd=tmp_path)
    assert done.stdout.split() == ["False", "True", "True"], done.stderr
