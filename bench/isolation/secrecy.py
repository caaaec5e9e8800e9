"""What other processes of the same user, a method's among them, can read of this one through ``/proc``."""

from __future__ import annotations

import contextlib
import ctypes
import sys

from bench.isolation.descendants import PRCTL

PR_SET_DUMPABLE = 4
ARG_START, ARG_END = 47, 48
"""Fields of ``/proc/self/stat``, counted from 0: the memory of the command line (proc_pid_stat(5))."""


def close_memory() -> None:
    """Have the memory and the environment of this process readable by the superuser alone (Linux)."""
    if PRCTL is not None:
        PRCTL(PR_SET_DUMPABLE, 0, 0, 0, 0)


def hide_arguments() -> None:
    """Overwrite the fields of the command line, which may hold true parameters, for whoever lists processes (Linux).

    The first words stay, ``python -m bench``; ``sys.argv`` is another copy and stays whole.
    """
    if sys.platform != "linux":
        return
    with contextlib.suppress(OSError, ValueError, IndexError):
        with open("/proc/self/stat", "rb") as file:
            text = file.read()
        fields = text[text.rindex(b")") + 2 :].split()  # the name before it may hold spaces
        start, end = (int(fields[i - 2]) for i in (ARG_START, ARG_END))
        memory = ctypes.string_at(start, end - start)
        visible = memory.find(b"=")
        if visible >= 0:
            visible = memory.rfind(b"\0", 0, visible) + 1
            ctypes.memset(start + visible, 0, end - start - visible)
