"""Faults of the machine: closed and full streams, folders that are gone or cannot be used, a full disk, Ctrl-C.

Each is one line and an exit status of 2 (130 for Ctrl-C), and no file is left that is half a file.
"""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import REPOSITORY
from forked import Call, Forked

FULL = Path("/dev/full")
NOBODY = 65534
CELL = "method=prior replicates=2 workers=1 store=rows archive=none"
Shell = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture
def shell(tmp_path: Path) -> Shell:
    """Return a function that runs a line of a shell in an empty folder; ``@bench`` stands for the command."""

    def run(line: str, **environment: str) -> subprocess.CompletedProcess[str]:
        bench = f"{shlex.quote(sys.executable)} -m bench"
        variables = {**os.environ, "PYTHONPATH": str(REPOSITORY), "PYTHONDONTWRITEBYTECODE": "1", **environment}
        command = ["bash", "-c", line.replace("@bench", bench)]
        return subprocess.run(command, cwd=tmp_path, env=variables, capture_output=True, text=True, timeout=300)

    return run


def test_a_full_error_stream_does_not_stop_a_run(shell: Shell, tmp_path: Path) -> None:
    done = shell(f"@bench {CELL} 2>/dev/full")
    assert done.returncode == 0
    assert len(list((tmp_path / "rows").glob("*.json"))) == 1
    assert done.stdout.splitlines()[-1].startswith("full result: ")


@pytest.mark.parametrize("closed", [">&-", ">&- 2>&-"])
def test_a_closed_output_is_reported_before_anything_is_computed(closed: str, shell: Shell, tmp_path: Path) -> None:
    done = shell(f"@bench {CELL} {closed}")
    assert done.returncode == 2
    assert list(tmp_path.iterdir()) == []
    message = "bench: output=closed: open it; > /dev/null discards the output\n"
    assert done.stderr == ("" if "2>&-" in closed else message)


@pytest.mark.skipif(not FULL.exists(), reason="this system has no /dev/full")
def test_a_full_output_is_one_line(shell: Shell) -> None:
    done = shell(f"@bench method=ls --cfg job > {FULL}")
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert "output=standard output: cannot be written: No space left on device; " in done.stderr


def test_a_closed_input_is_an_empty_stream(shell: Shell) -> None:
    done = shell("@bench track <&-")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("bench: stream=")


def test_a_removed_working_folder_is_one_line(shell: Shell) -> None:
    done = shell("mkdir removed; cd removed; rmdir ../removed; @bench method=prior replicates=2")
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith("bench: folder=")
    assert "removed: working folder: No such file or directory" in done.stderr


@pytest.mark.parametrize("long", [True, False], ids=["too long for a socket", "missing"])
def test_an_unusable_folder_of_temporary_files_is_one_line(shell: Shell, tmp_path: Path, long: bool) -> None:
    folder = tmp_path / ("x" * 130)
    folder.mkdir()
    done = shell(f"@bench {CELL} 2> errors", TMPDIR=str(folder if long else tmp_path / "none"))
    assert done.returncode == (2 if long else 0)
    errors = (tmp_path / "errors").read_text()
    assert "Traceback" not in errors
    assert ("bench: TMPDIR=" in errors) == long


REPORT = "report store=rows out=page.html"
INTERRUPTED = """
import os, signal, time
os.kill(os.getpid(), signal.SIGINT)
time.sleep(60)
"""


def test_ctrl_c_while_modules_are_imported_is_one_line(shell: Shell, tmp_path: Path) -> None:
    """Numpy, which every command imports, is replaced by a module that interrupts its import."""
    (tmp_path / "numpy.py").write_text(INTERRUPTED)
    done = shell(f"{shlex.quote(sys.executable)} -m bench tables", PYTHONPATH=f"{tmp_path}{os.pathsep}{REPOSITORY}")
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "\nbench: interrupted\n")


@pytest.mark.parametrize("line", ["tables store=rows", pytest.param(REPORT, marks=pytest.mark.slow)])
def test_a_full_disk_leaves_no_file(line: str, one_cell: Path, forked: Forked, tmp_path: Path) -> None:
    """Files are limited to 40 bytes: they can be created, but not written."""
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "rows").symlink_to(one_cell)
    ended = forked.run(Call([*line.split(), "archive=none"], str(tmp_path / "here"), largest_file=40))
    assert ended.status == 2, ended.err
    assert [path for path in (tmp_path / "here").rglob("*") if path.is_file() and "rows" not in path.parts] == []


DENIED = {
    "tables store=rows out=locked": "out=locked: cannot be written (Permission denied)",
    "method=prior store=locked": "store=locked: cannot be written (Permission denied)",
    "method=ls data=secret.csv": "data=secret.csv: cannot be read: Permission denied",
    "method=ls system=secret.yaml": "system=secret.yaml: cannot be read: Permission denied",
    "status store=hidden/rows": "store=hidden/rows: folder not found",
}


@pytest.mark.parametrize("line", DENIED)
def test_missing_permissions_are_one_line(line: str, one_cell: Path, forked: Forked, tmp_path: Path) -> None:
    here = tmp_path / "here"
    here.mkdir(mode=0o755)
    (here / "rows").mkdir()
    for path in one_cell.glob("*.*"):
        (here / "rows" / path.name).write_bytes(path.read_bytes())
    for name, mode in {"locked": 0o555, "hidden": 0o000}.items():
        (here / name).mkdir(mode=mode)
    for name in ("secret.csv", "secret.yaml", "README.md"):
        (here / name).write_text("0,1\n")
        (here / name).chmod(0o000)
    ended = forked.run(Call(line.split(), str(here), user=0 if os.getuid() else NOBODY))
    (here / "hidden").chmod(0o755)
    assert (ended.status, len(ended.err.splitlines())) == (2, 1), ended
    assert DENIED[line] in ended.err
    assert list((here / "locked").iterdir()) == []
