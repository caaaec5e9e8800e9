"""Sweeps on a machine that has little to give: a slow disk, few descriptors. Every cell is stored all the same."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from bench.store.store import Store

SLOW_DISK = """
import os, time
fsync = os.fsync
os.fsync = lambda handle: (time.sleep(0.1), fsync(handle))[1]
"""


def swept(
    tmp_path: Path, descriptors: int, *arguments: str, slow_disk: bool = False
) -> subprocess.CompletedProcess[str]:
    """A sweep in a shell that has so many descriptors, and no more to give."""
    environment = dict(os.environ)
    if slow_disk:
        (tmp_path / "sitecustomize.py").write_text(SLOW_DISK)
        environment["PYTHONPATH"] = os.pathsep.join([str(tmp_path), environment.get("PYTHONPATH", "")])
    command = [sys.executable, "-m", "bench", "-m", "archive=none", f"store={tmp_path / 'rows'}", *arguments]
    shell = ["/bin/sh", "-c", f'ulimit -n {descriptors} && exec "$@"', "sh", *command]
    return subprocess.run(shell, env=environment, capture_output=True, text=True, timeout=280)


def test_workers_are_as_many_as_descriptors_suffice_for(tmp_path: Path) -> None:
    done = swept(tmp_path, 64, "method=prior", "seed=range(0,6)", "replicates=1", "workers=11")
    assert done.returncode == 0, done.stderr
    assert len(Store(tmp_path / "rows").identities()) == 6
    assert "workers instead of 11: more need more open files than the system gives (ulimit -n)" in done.stderr


@pytest.mark.slow
def test_a_slow_disk_makes_a_sweep_slow_and_loses_nothing(tmp_path: Path) -> None:
    """Cells are fitted ten times as fast as they are stored: their claims would fill the table of descriptors."""
    done = swept(
        tmp_path, 64, "method=prior", "seed=range(0,150)", "replicates=1", "workers=1", slow_disk=True
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert len(Store(tmp_path / "rows").identities()) == 150
