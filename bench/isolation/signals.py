"""Signals of a command: Ctrl-C, SIGTERM and SIGHUP end it in one line, and what it has begun is cleared away.

Importing this module has Ctrl-C end the process in one line while the modules of a command are imported.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

PROGRAMS = ("-m", "vibration-bench")
"""What Python says that it runs while it imports the package of a command."""


class Ended(BaseException):
    """The process was asked to end by a signal; ``status`` is the exit status that a shell expects of it."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.status = 128 + number


@contextlib.contextmanager
def ended_by_signals() -> Iterator[None]:
    """Raise Ended in the main thread at the first SIGTERM or SIGHUP; later ones do not interrupt the clearing away.

    A signal that is ignored, as under ``nohup``, or handled by another, stays so.
    """

    def end(number: int, frame: Any) -> None:
        for taken in handled:
            signal.signal(taken, signal.SIG_IGN)
        raise Ended(number)

    in_main = threading.current_thread() is threading.main_thread()
    both = (signal.SIGTERM, signal.SIGHUP)
    handled = [number for number in both if in_main and signal.getsignal(number) is signal.SIG_DFL]
    for number in handled:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in handled:
            signal.signal(number, signal.SIG_DFL)


def interrupts_again() -> None:
    """Have Ctrl-C raise KeyboardInterrupt again, once the command takes care of it."""
    if signal.getsignal(signal.SIGINT) is _end_quietly:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _end_quietly(*_: Any) -> None:
    try:
        os.write(2, b"\nbench: interrupted\n")
    finally:
        os._exit(130)


if sys.argv and Path(sys.argv[0]).name in PROGRAMS and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, _end_quietly)
