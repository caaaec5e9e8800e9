"""What other processes of the same user, a method's among them, can learn of this one."""

from __future__ import annotations

import contextlib
import ctypes
import sys
import types
from collections.abc import Iterator

PRCTL = getattr(ctypes.CDLL(None), "prctl", None) if sys.platform == "linux" else None
"""Looked up once, by the server: each of its children would take longer for it than for all the rest of its start."""
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
    with contextlib.suppress(OSError, ValueError, IndexError):
        with open("/proc/self/stat", "rb") as file:
            text = file.read()
        fields = text[text.rindex(b")") + 2 :].split()  # the name before it may hold spaces
        start, end = (int(fields[i - 2]) for i in (ARG_START, ARG_END))
        memory = ctypes.string_at(start, end - start)
        if (visible := memory.find(b"=")) >= 0:
            visible = memory.rfind(b"\0", 0, visible) + 1
            ctypes.memset(start + visible, 0, end - start - visible)


@contextlib.contextmanager
def without_main() -> Iterator[None]:
    """Start processes that neither run the program's main module again nor get its arguments.

    The arguments may hold true parameters, and ``multiprocessing`` hands them on.
    """
    main, arguments = sys.modules["__main__"], sys.argv
    sys.modules["__main__"], sys.argv = types.ModuleType("__main__"), arguments[:1]
    try:
        yield
    finally:
        sys.modules["__main__"], sys.argv = main, arguments
