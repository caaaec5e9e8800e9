"""Limits for what runs in this process: its time, its memory, and the files that it writes."""

from __future__ import annotations

import os
import resource
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Literal

LONGEST_FILE = 64 << 20
"""Largest file that somebody else's code may write, its output included (bytes)."""


def limit_files() -> None:
    """Let a file that grows beyond the limit fail its write; Python ignores the signal that comes with it."""
    _lower(resource.RLIMIT_FSIZE, LONGEST_FILE)


def limit_memory(memory_mb: float) -> None:
    """Let one allocation beyond the limit fail at once, as an error that can be caught (Linux)."""
    if sys.platform.startswith("linux"):
        with open("/proc/self/status", "rb") as lines:  # as text, it would import a codec in every process
            data_kb = next((int(line.split()[1]) for line in lines if line.startswith(b"VmData")), 0)
        _lower(resource.RLIMIT_DATA, int(memory_mb * 2**20) + data_kb * 1024)


def limit_processor_time(seconds: float) -> None:
    """Have the kernel end what hangs where no other process can watch it any more, ``seconds`` from now."""
    usage = os.times()
    _lower(resource.RLIMIT_CPU, int(usage.user + usage.system + seconds) + 1)


def _lower(what: int, limit: int) -> None:
    _, hard = resource.getrlimit(what)
    resource.setrlimit(what, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))


@contextmanager
def limited(seconds: float, clock: Literal["wall", "processor"] = "wall") -> Iterator[None]:
    """Raise TimeoutError in what takes longer, as soon as Python code runs again; for a process's main thread."""

    def stop(number: int, frame: Any) -> None:
        raise TimeoutError(f"no answer within {seconds:g} s")

    wall = clock == "wall"
    timer, rings = (signal.ITIMER_REAL, signal.SIGALRM) if wall else (signal.ITIMER_PROF, signal.SIGPROF)
    before = signal.signal(rings, stop)
    signal.setitimer(timer, seconds)
    try:
        yield
    finally:
        signal.setitimer(timer, 0.0)
        signal.signal(rings, before)
