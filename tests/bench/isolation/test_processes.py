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
