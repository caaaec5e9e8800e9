"""A place of its own for a cluster's daemons: no network but loopback, a name, and no process left behind.

A Ray head listens on every interface whatever it is told, and daemons outlive the script that started them. In Linux
namespaces of its own, the script sees one interface, and whatever it started ends with it.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

INSIDE = "VIBRATION_BENCH_APART"
UNSHARE = ("unshare", "--net", "--uts", "--pid", "--fork", "--kill-child", "--mount-proc")

NETWORK = "ip link set lo up && ip address add 192.0.2.1/32 dev lo"
"""Loopback; with a second address, since Slurm looks names up only where there is one beside 127.0.0.1."""


def why_not() -> str:
    """Why no such place can be made here; empty where one can."""
    for tool in ("unshare", "ip", "hostname"):
        if shutil.which(tool) is None:
            return f"{tool} is not installed"
    tried = subprocess.run([*_unshare(), "true"], capture_output=True, text=True)
    return "" if tried.returncode == 0 else f"no namespaces here ({tried.stderr.strip().splitlines()[-1]})"


def run_apart(module: str, why_not: str, inside: Callable[[Path], int]) -> int:
    """Run ``inside`` with a temporary folder in such a place, by starting the module's main again there.

    Returns its exit status; 0 after a line that says ``why_not``, where that is said.
    """
    folder = os.environ.get(INSIDE)
    if folder:
        return inside(Path(folder))
    if why_not:
        print(f"{module.rpartition('.')[2]}: skipped: {why_not}")
        return 0
    command = f'{NETWORK} && hostname localhost && exec "{sys.executable}" -m {module}'
    with tempfile.TemporaryDirectory(prefix="bench-") as name:  # removed when nobody is left who writes there
        environment = {**os.environ, INSIDE: name, "OMP_NUM_THREADS": "1"}
        return subprocess.run([*_unshare(), "sh", "-c", command], env=environment).returncode


def wait_for(condition: Callable[[], bool], what: str, limit_s: float) -> None:
    """Wait until a condition holds; raises TimeoutError naming ``what`` where it does not within the limit."""
    deadline = time.monotonic() + limit_s
    while not condition():
        if time.monotonic() > deadline:
            raise TimeoutError(f"{what}: not within {limit_s:g} s")
        time.sleep(0.2)


def _unshare() -> Sequence[str]:
    return UNSHARE if os.geteuid() == 0 else (*UNSHARE, "--map-root-user")
