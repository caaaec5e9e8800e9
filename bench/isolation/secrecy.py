"""Protection of the true values from other processes of the same user, such as those of a method."""

from __future__ import annotations

import contextlib
import ctypes
import sys
import types
from collections.abc import Iterator

PRCTL = getattr(ctypes.CDLL(None), "prctl", None) if sys.platform == "linux" else None
"""Looked up once, in the server, since the lookup would dominate the start of a child."""
PR_SET_DUMPABLE = 4
ARG_START, ARG_END = 47, 48
"""Fields of ``/proc/self/stat``, counted from 0: the memory of the command line (proc_pid_stat(5))."""


def close_memory() -> None:
    """Make the memory and environment of this process readable by the superuser only (Linux)."""
    if PRCTL is not None:
        PRCTL(PR_SET_DUMPABLE, 0, 0, 0, 0)


def hide_arguments() -> None:
    """Overwrite the command line that process listings show, since it may contain true parameters (Linux).

    The first words, such as ``python -m bench``, remain; ``sys.argv`` is a copy and is not changed.
    """
    with contextlib.suppress(OSError, ValueError, IndexError):
        with open("/proc/self/stat", "rb") as file:
            text = file.read()
        fields = text[text.rindex(b")") + 2 :].split()  # the process name before it may contain spaces
        start, end = (int(fields[i - 2]) for i in (ARG_START, ARG_END))
        memory = ctypes.string_at(start, end - start)
        if (visible := memory.find(b"=")) >= 0:
            visible = memory.rfind(b"\0", 0, visible) + 1
            ctypes.memset(start + visible, 0, end - start - visible)


@contextlib.contextmanager
def without_main() -> Iterator[None]:
    """Start processes without the main module and the arguments of this program.

    ``multiprocessing`` would pass on the arguments, which may contain true parameters.
    """
    main, arguments = sys.modules["__main__"], sys.argv
    sys.modules["__main__"], sys.argv = types.ModuleType("__main__"), arguments[:1]
    try:
        yield
    finally:
        sys.modules["__main__"], sys.argv = main, arguments
