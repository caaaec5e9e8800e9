"""All that a process has started, and its end, also where a descendant has left its group, session or parent.

A process group alone is no bound: a daemon leaves it. So every child, and the server that starts it, adopts what its
descendants leave behind (PR_SET_CHILD_SUBREAPER of Linux; elsewhere a daemon is not found).
"""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Collection

import psutil

from bench.isolation.secrecy import PRCTL

PR_SET_CHILD_SUBREAPER = 36


def adopt() -> None:
    """Have orphans among the descendants of this process become its children, instead of those of the first process."""
    if PRCTL is not None:
        PRCTL(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def children_of(pid: int) -> list[int]:
    """Return the processes that a process has started or adopted, and that have not been waited for."""
    children = []
    try:
        for task in os.listdir(f"/proc/{pid}/task"):
            with open(f"/proc/{pid}/task/{task}/children", "rb") as file:
                children += [int(number) for number in file.read().split()]
    except OSError:  # the kernel keeps no such lists, or the process has ended
        with contextlib.suppress(psutil.Error):
            return [child.pid for child in psutil.Process(pid).children()]
    return children


def descendants_of(pid: int) -> list[int]:
    """Return all that a process has started, however deep, the nearest first."""
    descendants = children_of(pid)
    for child in descendants:  # which grows meanwhile
        descendants += children_of(child)
    return descendants


def end_descendants(pid: int) -> None:
    """Kill all that a process has started, but not itself."""
    for _ in range(3):  # one may fork while it is looked for
        descendants = descendants_of(pid)
        for descendant in descendants:
            kill(descendant)
        if not descendants:
            return


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
                kill(pid)


def kill(pid: int) -> None:
    """Kill a process, if it is there."""
    with contextlib.suppress(OSError):
        os.kill(pid, signal.SIGKILL)
