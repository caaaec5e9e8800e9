"""A place of its own for a cluster's daemons: no network but loopback, a name, and no process left behind.

A Ray head listens on every interface whatever its options say, and daemons outlive the script that started them. In
Linux namespaces of its own, the script sees one interface, and whatever it started ends with it.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

INSIDE = "VIBRATION_BENCH_APART"
UNSHARE = ("unshare", "--net", "--uts", "--pid", "--fork", "--kill-child", "--mount-proc")
NETWORK = "ip link set lo up && ip address add 192.0.2.1/32 dev lo"
"""Loopback; with a second address, since Slurm looks names up only where there is one beside 127.0.0.1."""


def run_apart(module: str, tools: Sequence[str], reason: str, inside: Callable[[Path], int]) -> int:
    """Run ``inside`` with a temporary folder in such a place, by starting the module's main again there.

    Returns its exit status; 0 after one line where a tool is missing or there is another reason not to.
    """
    if folder := os.environ.get(INSIDE):
        return inside(Path(folder))
    unshare = UNSHARE if os.geteuid() == 0 else (*UNSHARE, "--map-root-user")
    absent = [tool for tool in ("unshare", "ip", "hostname", *tools) if shutil.which(tool) is None]
    if absent or reason:
        print(f"{module}: skipped: {reason or f'{absent[0]} is not installed'}")
        return 0
    if subprocess.run([*unshare, "true"], capture_output=True).returncode:
        print(f"{module}: skipped: no namespaces here")
        return 0
    command = f'{NETWORK} && hostname localhost && exec "{sys.executable}" -m {module}'
    with tempfile.TemporaryDirectory(prefix="bench-") as name:  # removed when nobody is left who writes there
        around = {**os.environ, INSIDE: name, "OMP_NUM_THREADS": "1"}
        return subprocess.run([*unshare, "sh", "-c", command], env=around).returncode
