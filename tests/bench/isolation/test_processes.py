"""The server of processes: a package that it lacks is imported by another."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from conftest import Python

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


def test_a_server_that_lacks_a_package_is_started_again(tmp_path: Path, python: Python) -> None:
    """A command starts it before it knows which method it runs."""
    (tmp_path / "restarted.py").write_text(RESTARTED)
    path = os.pathsep.join([str(tmp_path), *sys.path])
    done = python("-c", "import restarted; restarted.main()", env={"PYTHONPATH": path})
    assert done.stdout.split() == ["False", "True", "True"], done.stderr


SLOW_STATUS = """
import os, threading, time
from multiprocessing import forkserver
from bench.isolation.processes import Children, Died

def serve(connection):
    os._exit(3)

def slowly(descriptor, read=forkserver.read_signed):
    time.sleep(0.02)
    return read(descriptor)

def main():
    messages = []

    def work():
        for _ in range(5):
            child = children.start(serve)
            try:
                child.receive(60.0)
            except Died as died:
                messages.append(died.message)

    with Children() as children:
        forkserver.read_signed = slowly
        threads = [threading.Thread(target=work) for _ in range(3)]
        for thread in threads: thread.start()
        for thread in threads: thread.join()
    print(*sorted(set(messages)))
"""


def test_an_exit_status_that_a_start_could_read_as_well_is_read_once(tmp_path: Path, python: Python) -> None:
    """Python reads the status of every child when it starts one, and gives 255 where another thread was faster."""
    (tmp_path / "slow_status.py").write_text(SLOW_STATUS)
    path = os.pathsep.join([str(tmp_path), *sys.path])
    done = python("-c", "import slow_status; slow_status.main()", env={"PYTHONPATH": path})
    assert done.stdout.strip() == "the process exited with status 3", done.stderr


INTERRUPTED = """
import os, signal
os.kill(os.getpid(), signal.SIGINT)
"""
INTERRUPTING = """
from bench.engine.pool import serve_tasks
from bench.isolation.processes import Children

with Children(("interrupted",)) as children:
    print(children.start(serve_tasks).receive(60.0).decode())
"""


def test_ctrl_c_while_the_server_imports_does_not_reach_it(tmp_path: Path, python: Python) -> None:
    (tmp_path / "interrupted.py").write_text(INTERRUPTED)
    done = python("-c", INTERRUPTING, env={"PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])})
    assert (done.stdout.split(), done.stderr) == (["ready"], "")
