"""A limit of time for what runs in this process."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Literal


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
