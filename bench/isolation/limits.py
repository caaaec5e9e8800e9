"""Limits of this process: time, memory, and the size of the files that it writes."""

from __future__ import annotations

import os
import resource
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Literal

LONGEST_FILE = 64 << 20
"""Largest file that a method may write, its printed output included (bytes)."""


def limit_files() -> None:
    """Make writing beyond :data:`LONGEST_FILE` raise OSError; Python ignores the accompanying signal."""
    _lower(resource.RLIMIT_FSIZE, LONGEST_FILE)


def limit_memory(memory_mb: float) -> None:
    """Make allocations beyond the limit raise MemoryError (Linux)."""
    if sys.platform.startswith("linux"):
        with open("/proc/self/status", "rb") as lines:  # text mode would import a codec in every process
            data_kb = next((int(line.split()[1]) for line in lines if line.startswith(b"VmData")), 0)
        _lower(resource.RLIMIT_DATA, int(memory_mb * 2**20) + data_kb * 1024)


def limit_processor_time(seconds: float) -> None:
    """Make the kernel end this process after ``seconds`` more of processor time, even if its parent has died."""
    usage = os.times()
    _lower(resource.RLIMIT_CPU, int(usage.user + usage.system + seconds) + 1)


def _lower(what: int, limit: int) -> None:
    _, hard = resource.getrlimit(what)
    resource.setrlimit(what, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))


@contextmanager
def limited(seconds: float, clock: Literal["wall", "processor"] = "wall") -> Iterator[None]:
    """Raise TimeoutError in the main thread after ``seconds``, as soon as Python code runs again."""

    def stop(number: int, frame: Any) -> None:
        raise TimeoutError(f"no answer within {seconds:g} s")

    wall = clock == "wall"
    timer, number = (signal.ITIMER_REAL, signal.SIGALRM) if wall else (signal.ITIMER_PROF, signal.SIGPROF)
    previous = signal.signal(number, stop)
    signal.setitimer(timer, seconds)
    try:
        yield
    finally:
        signal.setitimer(timer, 0.0)
        signal.signal(number, previous)
