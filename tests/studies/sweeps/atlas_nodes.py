"""A slice of the atlas by Ray and by Slurm on this machine, beside processes: the same blocks, from the same command.

    python -m tests.studies.sweeps.atlas_nodes

Each engine has a store of its own, in a temporary folder, and a network of loopback alone. It prints the time, the
blocks that were made, and how many of them are the same to the bit as those of processes, but for the time of a fit.
"""

from __future__ import annotations

import os
import secrets
import shlex
import shutil
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from tabulate import tabulate

from tests.studies.sweeps import slurm
from tests.studies.sweeps.apart import run_apart, wait_for, why_not

COMMAND = ("-m", "bench", "-m", "experiment=atlas", "part=samples_snr", "method=matrix_pencil,iqml", "points=128")
BLOCKS = 16
JOBS = 3
SECONDS = 2
"""The column of a block that holds the time of a fit."""


def main() -> int:
    """Run, or say in one line why not."""
    return run_apart("tests.studies.sweeps.atlas_nodes", why_not(), _inside)


def _inside(folder: Path) -> int:
    os.environ["PATH"] += ":/usr/sbin:/sbin"
    rows: list[list[object]] = []
    stores: dict[str, Path] = {}
    good = True
    for name, attempt in (("processes", _processes), ("ray", _ray), ("slurm", _slurm)):
        stores[name] = folder / name
        started = time.monotonic()
        reason = attempt(folder, stores[name])
        if reason:
            rows.append([name, reason, "", ""])
            continue
        made = sorted(path.name for path in stores[name].glob("*.result"))
        same = sum(_same(stores["processes"] / one, stores[name] / one) for one in made)
        rows.append([name, f"{time.monotonic() - started:.0f}", len(made), same])
        good &= len(made) == same == BLOCKS
    print(tabulate(rows, headers=["engine", "s", "blocks", "the same as of processes"]))
    return 0 if good else 1


def _same(one: Path, other: Path) -> bool:
    first, second = (np.delete(np.load(path), SECONDS, axis=1) for path in (one, other))
    return bool(np.array_equal(first, second, equal_nan=True))


def _command(store: Path, *more: str) -> list[str]:
    return [sys.executable, *COMMAND, f"store={store}", f"out={store}-out", *more]


def _run(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True, timeout=900)
    if done.returncode:
        raise RuntimeError(f"{shlex.join(command)}: {done.stderr[-2000:]}")


def _processes(folder: Path, store: Path) -> str:
    _run(_command(store))
    return ""


def _ray(folder: Path, store: Path) -> str:
    """By Ray, started on this machine."""
    if find_spec("ray") is None:
        return "ray is not installed (pip install 'vibration-bench[ray]')"
    os.environ |= {
        "RAY_AUTH_MODE": "token",
        "RAY_AUTH_TOKEN": secrets.token_hex(32),
        "RAY_USAGE_STATS_ENABLED": "0",
        "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
    }
    _run(_command(store, "hydra/launcher=ray"))
    return ""


def _slurm(folder: Path, store: Path) -> str:
    """By an array of jobs, of which each takes its share."""
    tool = next((name for name in slurm.TOOLS if shutil.which(name) is None), "")
    if tool or os.geteuid() != 0:
        return f"{tool} is not installed" if tool else "Slurm's daemons are started as root here"
    daemons: list[subprocess.Popen[bytes]] = []
    try:
        slurm.start(folder, daemons)
        wrapped = shlex.join(_command(store, "workers=1"))
        _run(["sbatch", f"--array=1-{JOBS}", f"--output={folder}/job-%a.out.log", "--wrap", wrapped])
        wait_for(lambda: not slurm.asked("squeue", "-h").strip(), "an empty queue", 600)
        return ""
    finally:
        for daemon in reversed(daemons):
            daemon.terminate()


if __name__ == "__main__":
    sys.exit(main())
