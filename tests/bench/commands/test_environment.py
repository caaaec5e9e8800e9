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

from bench.errors import InputError
from bench.reporting.whole_file import write

FULL = Path("/dev/full")
NOBODY = 65534
CELL = "method=prior replicates=2 workers=1 store=rows archive=none"
Shell = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture
def shell(tmp_path: Path) -> Shell:
    """Run a shell's line in an empty folder; ``bench`` in it is the command of this Python."""

    def run(line: str, **environment: str) -> subprocess.CompletedProcess[str]:
        bench = f"{shlex.quote(sys.executable)} -m bench"
        variables = {**os.environ, "PYTHONPATH": str(REPOSITORY), "PYTHONDONTWRITEBYTECODE": "1", **environment}
        command = ["bash", "-c", line.replace("@bench", bench)]
        return subprocess.run(command, cwd=tmp_path, env=variables, capture_output=True, text=True, timeout=300)

    return run


def test_a_full_error_stream_stops_nothing(shell: Shell, tmp_path: Path) -> None:
    done = shell(f"@bench {CELL} 2>/dev/full")
    assert done.returncode == 0
    assert len(list((tmp_path / "rows").glob("*.json"))) == 1
    assert done.stdout.splitlines()[-1].startswith("full result: ")


@pytest.mark.parametrize("closed", [">&-", ">&- 2>&-"])
def test_a_closed_output_is_said_before_anything_is_computed(closed: str, shell: Shell, tmp_path: Path) -> None:
    done = shell(f"@bench {CELL} {closed}")
    assert done.returncode == 2
    assert list(tmp_path.iterdir()) == []
    said = "bench: output=closed: an output that can be written; > /dev/null where none is wanted\n"
    assert done.stderr == ("" if "2>&-" in closed else said)


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


def test_a_working_folder_that_is_gone_is_one_line(shell: Shell) -> None:
    done = shell("mkdir gone; cd gone; rmdir ../gone; @bench method=prior replicates=2")
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith("bench: folder=")
    assert "gone: where you are: No such file or directory" in done.stderr


@pytest.mark.parametrize("long", [True, False], ids=["too long for a socket", "not there"])
def test_a_folder_of_temporary_files_that_cannot_serve_is_one_line(shell: Shell, tmp_path: Path, long: bool) -> None:
    folder = tmp_path / ("x" * 130)
    folder.mkdir()
    done = shell(f"@bench {CELL} 2> said", TMPDIR=str(folder if long else tmp_path / "none"))
    assert done.returncode == (2 if long else 0)
    said = (tmp_path / "said").read_text()
    assert "Traceback" not in said
    assert ("bench: TMPDIR=" in said) == long


REPORT = "report store=rows out=page.html"
INTERRUPTED = """
import os, signal, time
os.kill(os.getpid(), signal.SIGINT)
time.sleep(60)
"""


def test_ctrl_c_while_modules_are_imported_is_one_line(shell: Shell, tmp_path: Path) -> None:
    """A package that every command needs is replaced by one that interrupts its import."""
    (tmp_path / "numpy.py").write_text(INTERRUPTED)
    done = shell(f"{shlex.quote(sys.executable)} -m bench tables", PYTHONPATH=f"{tmp_path}{os.pathsep}{REPOSITORY}")
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "\nbench: interrupted\n")


@pytest.mark.parametrize("line", ["tables store=rows", pytest.param(REPORT, marks=pytest.mark.slow)])
def test_a_full_disk_leaves_no_file(line: str, one_cell: Path, forked: Forked, tmp_path: Path) -> None:
    """Files may hold 40 bytes here: an empty one can be made, and nothing be written into it."""
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "rows").symlink_to(one_cell)
    ended = forked.run(Call([*line.split(), "archive=none"], str(tmp_path / "here"), largest_file=40))
    assert ended.status == 2, ended.err
    assert [path for path in (tmp_path / "here").rglob("*") if path.is_file() and "rows" not in path.parts] == []


def test_a_file_that_cannot_be_finished_leaves_the_one_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path / "page", "before")

    def full(number: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputError, match="No space left on device"):
        write(tmp_path / "page", "after")
    assert [path.name for path in tmp_path.iterdir()] == ["page"]
    assert (tmp_path / "page").read_text() == "before"


DENIED = {
    "tables store=rows out=locked": "out=locked: cannot be written (Permission denied)",
    "method=prior store=locked": "store=locked: cannot be written (Permission denied)",
    "method=ls data=secret.csv": "data=secret.csv: cannot be read: Permission denied",
    "method=ls system=secret.yaml": "system=secret.yaml: it cannot be read: Permission denied",
    "status store=hidden/rows": "store=hidden/rows: folder not found",
}


@pytest.mark.parametrize("line", DENIED)
def test_what_may_not_be_read_or_written_is_one_line(line: str, one_cell: Path, forked: Forked, tmp_path: Path) -> None:
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
