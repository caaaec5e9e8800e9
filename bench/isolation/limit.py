"""Limits for what runs in this process: its time, and the files that it writes."""

from __future__ import annotations

import resource
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Literal

LONGEST_FILE = 64 << 20
"""Of whatever somebody else's code writes, its output included (bytes)."""


def limit_files() -> None:
    """Let a file that grows beyond the limit fail its write; Python ignores the signal that comes with it."""
    _, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    if hard == resource.RLIM_INFINITY or hard > LONGEST_FILE:
        resource.setrlimit(resource.RLIMIT_FSIZE, (LONGEST_FILE, hard))


@contextmanager
def limited(seconds: float, clock: Literal["wall", "processor"] = "wall") -> Iterator[None]:
    """Raise TimeoutError in what takes longer, as soon as Python gets to say so; without timers there is no limit.

    For the main thread of a process: signals reach no other.
    """

    def stop(number: int, frame: Any) -> None:
        raise TimeoutError(f"no answer within {seconds:g} s")

    if not hasattr(signal, "setitimer"):
        yield
        return
    timer, rings = {
        "wall": (signal.ITIMER_REAL, signal.SIGALRM),
        "processor": (signal.ITIMER_PROF, signal.SIGPROF),
    }[clock]
    before = signal.signal(rings, stop)
    signal.setitimer(timer, seconds)
    try:
        yield
    finally:
        signal.setitimer(timer, 0.0)
        signal.signal(rings, before)
