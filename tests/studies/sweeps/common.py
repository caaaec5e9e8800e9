"""What the studies share: a stand-in method, sweeps as child processes, and what a store got, counted by the kernel.

Daemons of a cluster run in Linux namespaces: a Ray head listens on every interface whatever its options say, and
daemons outlive the script that started them. In namespaces of its own, the script sees one interface, and whatever it
started ends with it.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import re
import shutil
import struct
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from bench import Card, Estimate, Identifier, Normal, Problem

ROOT = Path(__file__).parents[3]
CELL = re.compile(r"([0-9a-f]{20})\.\w+")
"""The name of a cell's own file; files beside it have further parts."""
MOVED_TO = 0x80
"""IN_MOVED_TO of inotify(7): how a whole file arrives."""
EVENT = struct.Struct("iIII")


@dataclass(frozen=True)
class StandIn(Identifier):
    """Uses ``seconds`` of processor time, and answers with numbers from its random stream."""

    seconds: float = 0.0
    card: ClassVar[Card] = Card("a stand-in", "not used", "groups", "simulated", "none", "studies")

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        burn(self.seconds)
        names = tuple(group.name for group in problem.system.groups)
        return Estimate(problem.system, groups=Normal(names, np.exp(rng.normal(2.0, 0.1, len(names))), None, log=False))


def burn(seconds: float) -> None:
    """Use processor time."""
    end = time.process_time() + seconds
    while time.process_time() < end:
        sum(range(1000))


def environment(folder: Path) -> dict[str, str]:
    """Return an environment in which the stand-in is registered as ``stand_in``, as an installed package would do."""
    info = folder / "site" / "stand_in-0.dist-info"
    info.mkdir(parents=True, exist_ok=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: stand-in\nVersion: 0\n")
    (info / "entry_points.txt").write_text("[bench.methods]\nstand_in = tests.studies.sweeps.common:StandIn\n")
    path = os.pathsep.join([str(ROOT), str(info.parent), os.environ.get("PYTHONPATH", "")])
    return {**os.environ, "PYTHONPATH": path.rstrip(os.pathsep), "VIBRATION_BENCH_ARCHIVE": "none"}


def start(folder: Path, *arguments: str, log: str = "bench.log", **more: str) -> subprocess.Popen[str]:
    """Start ``python -m bench`` in a folder; its error stream is appended to a log there."""
    command = [sys.executable, "-m", "bench", *arguments]
    with (folder / log).open("a") as errors:
        return subprocess.Popen(
            command, cwd=folder, env=environment(folder) | more, stdout=subprocess.PIPE, stderr=errors, text=True
        )


def finish(process: subprocess.Popen[str]) -> tuple[int, str]:
    """Wait for a process; return its exit status and standard output."""
    out, _ = process.communicate()
    return process.returncode, out


def stored_cells(store: Path) -> set[str]:
    """Return the names of the stored cells."""
    return {found[1] for path in store.iterdir() if (found := CELL.fullmatch(path.name))}


def results(folder: Path, *sweep: str) -> dict[str, Any]:
    """Return what a finished sweep printed of every cell, by cell; times apart."""
    lines = finish(start(folder, *sweep, "format=json"))[1].splitlines()
    return {one["cell"]: {**one, "wall_s": None} for one in map(json.loads, lines)}


class Journal:
    """How often each cell was stored since the journal was made (Linux: inotify)."""

    def __init__(self, folder: Path) -> None:
        libc = ctypes.CDLL(None, use_errno=True)
        self._handle = libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
        if libc.inotify_add_watch(self._handle, os.fsencode(folder), MOVED_TO) < 0:
            raise OSError(ctypes.get_errno(), "inotify_add_watch", str(folder))
        self._stored: Counter[str] = Counter()

    def stored(self) -> Counter[str]:
        """Return how often each cell was stored so far."""
        with contextlib.suppress(BlockingIOError):
            while content := os.read(self._handle, 65536):
                place = 0
                while place < len(content):
                    name_end = place + EVENT.size + EVENT.unpack_from(content, place)[3]
                    name = content[place + EVENT.size : name_end].rstrip(b"\0").decode()
                    self._stored.update(found[1] for found in [CELL.fullmatch(name)] if found)
                    place = name_end
        return self._stored


def wait_for(condition: Callable[[], bool], what: str, limit_s: float) -> None:
    """Wait until a condition holds; raises TimeoutError naming it where it does not within the limit."""
    deadline = time.monotonic() + limit_s
    while not condition():
        if time.monotonic() > deadline:
            raise TimeoutError(f"{what}: not within {limit_s:g} s")
        time.sleep(0.2)


def report(title: str, rows: Sequence[tuple[str, object, object]]) -> int:
    """Print measured values beside wanted ones; return the exit status, 0 where all agree."""
    print(title)
    for what, measured, wanted in rows:
        print(f"  {'ok ' if measured == wanted else 'NOT'} {what}: {measured} (wanted {wanted})")
    return int(any(measured != wanted for _, measured, wanted in rows))


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
