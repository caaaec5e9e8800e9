"""Termination of all descendants of a process, including those that have left its process group or session.

A daemon leaves its process group. Therefore every child, and the server that starts the children, adopts orphaned
descendants (``PR_SET_CHILD_SUBREAPER`` of Linux). On other systems daemons are not found.
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
    """Make orphaned descendants of this process its children, instead of those of the init process."""
    if PRCTL is not None:
        PRCTL(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def children_of(pid: int) -> list[int]:
    """Return the children of a process, adopted ones and zombies included."""
    children = []
    try:
        for task in os.listdir(f"/proc/{pid}/task"):
            with open(f"/proc/{pid}/task/{task}/children", "rb") as file:
                children += [int(number) for number in file.read().split()]
    except OSError:  # the kernel has no such lists, or the process has ended
        with contextlib.suppress(psutil.Error):
            return [child.pid for child in psutil.Process(pid).children()]
    return children


def descendants_of(pid: int) -> list[int]:
    """Return all descendants of a process, the nearest first."""
    descendants = children_of(pid)
    for child in descendants:  # the list grows during the iteration
        descendants += children_of(child)
    return descendants


def end_descendants(pid: int) -> None:
    """Kill all descendants of a process, but not the process itself."""
    for _ in range(3):  # a descendant may fork during the search
        descendants = descendants_of(pid)
        for descendant in descendants:
            kill(descendant)
        if not descendants:
            return


def end_own_descendants() -> None:
    """Kill all descendants of this process."""
    with contextlib.suppress(ChildProcessError):  # raised at once if there are no children
        os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
        end_descendants(os.getpid())


def end_orphans(server: int, known: Collection[int]) -> None:
    """Kill orphans that the server has adopted: children that are neither known nor in the server's process group."""
    for pid in children_of(server):
        with contextlib.suppress(OSError):
            if pid not in known and os.getpgid(pid) != os.getpgid(server):
                end_descendants(pid)
                kill(pid)


def kill(pid: int) -> None:
    """Kill a process, if it exists."""
    with contextlib.suppress(OSError):
        os.kill(pid, signal.SIGKILL)
