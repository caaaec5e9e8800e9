"""Measurements in child processes, each with limits of processor time and memory, by the code of a given folder."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import psutil

from bench.isolation.machine import THREAD_VARIABLES
from tests.studies.engines.row import NO_MEMORY

ROOT = Path(__file__).parents[3]
ROW = Path(__file__).with_name("row.py")
MEMORY_MB = 8192.0
OUT_OF_MEMORY = ("MemoryError", "bad_alloc", "RESOURCE_EXHAUSTED", "Out of memory", "Cannot allocate memory")
LATE = "not in"
POLL_S = 0.05
PATIENCE = 20.0
"""By the clock a child may take so many times its processor time: it shares the machine with others."""


@dataclass(frozen=True)
class Outcome:
    """The answers of one or several children of one task; ``failure`` is a sentence where there are none.

    ``seconds`` of processor time a fit, in the order in which they were measured; ``peak_mb`` is the whole process's,
    with all that it imports.
    """

    seconds: tuple[float, ...] = ()
    answers: tuple[dict[str, Any], ...] = ()
    data: str = ""
    peak_mb: float = float("nan")
    failure: str = ""
    modules: tuple[str, ...] = ()

    @property
    def best(self) -> float:
        """The least time a fit; nan without one."""
        return min(self.seconds, default=float("nan"))

    @property
    def late(self) -> bool:
        """Decide whether the limit of time ended it."""
        return self.failure.startswith(LATE)

    @property
    def evaluations(self) -> float:
        """Responses evaluated a fit, in the mean over the data sets."""
        return sum(a["evaluations"] for a in self.answers) / len(self.answers) if self.answers else float("nan")

    @property
    def failed(self) -> int:
        """Data sets without an estimate."""
        return sum(answer["status"] != "ok" for answer in self.answers)

    def with_more(self, other: Outcome) -> Outcome:
        """The same with the times of a further child; its answers stay those of the first."""
        if self.failure or other.failure:
            return self if self.failure else other
        return replace(self, seconds=self.seconds + other.seconds, peak_mb=max(self.peak_mb, other.peak_mb))


def environment(folder: Path) -> dict[str, str]:
    """Return a child's environment: the code of a folder, one thread, no archive, nothing compiled beforehand."""
    own = {key: value for key, value in os.environ.items() if not key.startswith("JAX_")}
    one = dict.fromkeys(THREAD_VARIABLES, "1")
    return {**own, **one, "PYTHONPATH": str(folder), "VIBRATION_BENCH_ARCHIVE": "none"}


def answered(
    command: Sequence[str], task: dict[str, Any], folder: Path = ROOT, python: str = sys.executable
) -> dict[str, Any] | str:
    """Return the JSON on the last line that a child prints; or a sentence that says why there is none.

    From one line that it prints to the next it may use ``task["limit_s"]`` of processor time; its memory it limits by
    itself.
    """
    with tempfile.TemporaryDirectory() as name:
        out, errors = Path(name) / "out", Path(name) / "errors"
        with out.open("w") as to, errors.open("w") as wrong:
            child = subprocess.Popen(
                [python, *command, json.dumps(task)],
                cwd=folder, env=environment(folder), stdout=to, stderr=wrong,
            )  # fmt: skip
            if not _in_time(child, out, task["limit_s"]):
                return f"{LATE} {task['limit_s']:g} s"
        lines = out.read_text(encoding="utf-8").strip().splitlines()
        said = errors.read_text(encoding="utf-8", errors="replace").strip()
    if child.returncode == NO_MEMORY or (child.returncode != 0 and any(word in said for word in OUT_OF_MEMORY)):
        return "out of memory"
    if child.returncode != 0 or not lines:
        return f"crashed: {(said.splitlines() or [f'exit status {child.returncode}'])[-1]}"
    found: dict[str, Any] = json.loads(lines[-1])
    return found


def _in_time(child: subprocess.Popen[bytes], out: Path, limit_s: float) -> bool:
    """Wait for a child; False where it has used more than the limit since its last line, and is ended."""
    started, since, size = time.monotonic(), 0.0, 0
    try:
        while child.poll() is None:
            time.sleep(POLL_S)
            used = _processor_seconds(child.pid)
            if out.stat().st_size != size:
                since, size = used, out.stat().st_size
            if used - since > limit_s or time.monotonic() - started > PATIENCE * limit_s:
                return False
        return True
    finally:
        child.kill()
        child.wait()


def _processor_seconds(pid: int) -> float:
    """Return the processor time of a process so far; 0 where it has ended."""
    try:
        times = psutil.Process(pid).cpu_times()
    except psutil.Error:
        return 0.0
    return float(times.user + times.system)


def measured(task: dict[str, Any], folder: Path = ROOT) -> Outcome:
    """A task of ``row.py`` by the code of a folder. The script's own folder is not on its path."""
    found = answered(["-P", str(ROW)], task, folder)
    if isinstance(found, str):
        return Outcome(failure=found)
    lists = {name: tuple(value) for name, value in found.items() if isinstance(value, list)}
    return Outcome(**{**found, **lists})
