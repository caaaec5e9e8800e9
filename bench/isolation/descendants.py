"""All that a process has started, and its end, be it that a descendant has left its group, session or parent.

A process group alone is no bound: a daemon leaves it. So every child, and the server that starts it, adopts what its
descendants leave behind (PR_SET_CHILD_SUBREAPER of Linux; elsewhere a daemon is not found).
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import sys
from collections.abc import Collection

import psutil

PRCTL = getattr(ctypes.CDLL(None), "prctl", None) if sys.platform == "linux" else None
"""Looked up once, by the server: each of its children would take longer for it than for all the rest of its start."""
PR_SET_CHILD_SUBREAPER = 36


def adopt() -> None:
    """Have orphans among the descendants of this process become its children, instead of those of the first process."""
    if PRCTL is not None:
        PRCTL(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def children_of(pid: int) -> list[int]:
    """The processes that a process has started or adopted, and that have not been waited for."""
    try:
        lists = [_listed(f"/proc/{pid}/task/{task}/children") for task in os.listdir(f"/proc/{pid}/task")]
        return [child for listed in lists for child in listed]
    except OSError:  # the kernel keeps no such lists, or the process has ended
        with contextlib.suppress(psutil.Error):
            return [child.pid for child in psutil.Process(pid).children()]
    return []


def _listed(path: str) -> list[int]:
    handle = os.open(path, os.O_RDONLY)
    try:
        text = b""
        while more := os.read(handle, 1 << 16):
            text += more
        return [int(number) for number in text.split()]
    finally:
        os.close(handle)


def descendants_of(pid: int) -> list[int]:
    """All that a process has started, however deep, those nearest first."""
    found: list[int] = []
    waiting = children_of(pid)
    while waiting:
        found += waiting
        waiting = [deeper for one in waiting for deeper in children_of(one)]
    return found


def end_descendants(pid: int) -> None:
    """Kill all that a process has started, but not itself."""
    for _ in range(3):  # one that forks while it is looked for
        if not (found := descendants_of(pid)):
            return
        for one in found:
            _kill(one)


def end_own_descendants() -> None:
    """Kill all that this process has started; where that is nothing, the system says so at once."""
    with contextlib.suppress(ChildProcessError):
        os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
        end_descendants(os.getpid())


def end_orphans(server: int, known: Collection[int]) -> None:
    """Kill what ended children have left to their server: it is no child that is known, nor of the server's group."""
    for pid in children_of(server):
        with contextlib.suppress(OSError):
            if pid not in known and os.getpgid(pid) != os.getpgid(server):
                end_descendants(pid)
                _kill(pid)


def _kill(pid: int) -> None:
    with contextlib.suppress(OSError):
        os.kill(pid, signal.SIGKILL)
