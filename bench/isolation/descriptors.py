"""File descriptors: as many as the system gives, and no more workers than they suffice for."""

from __future__ import annotations

import contextlib
import os
import resource

RESERVE = 32
"""Kept free for the server of processes, for reading and writing the store, and for what imports open."""
A_WORKER = 16
"""Descriptors of a worker: three processes of three each, a share of a writer, claims, and the copies of a start."""


def raise_limit() -> None:
    """Raise the soft limit of open descriptors to the hard one, for this process and all that it starts."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != hard:
        with contextlib.suppress(OSError, ValueError):  # macOS has a limit of its own below an infinite one
            resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))


def affordable_workers(wanted: int) -> int:
    """How many of the wanted workers the free descriptors suffice for, at least one."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY:
        return wanted
    return max(1, min(wanted, (soft - _open_now() - RESERVE) // A_WORKER))


def _open_now() -> int:
    for folder in ("/proc/self/fd", "/dev/fd"):
        with contextlib.suppress(OSError):
            return len(os.listdir(folder))
    return 0
