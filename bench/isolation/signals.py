"""Signals of a command: Ctrl-C, SIGTERM and SIGHUP end it after cleaning up, with a message of one line.

After the import of this module, Ctrl-C during the import of the other modules also ends the process in one line.
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
"""Values of ``sys.argv[0]`` while the package of a command is imported."""


class Ended(BaseException):
    """The process was asked to end by a signal; ``status`` is the conventional exit status."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.status = 128 + number


@contextlib.contextmanager
def raise_on_signals() -> Iterator[None]:
    """Raise Ended in the main thread at the first SIGTERM or SIGHUP; later signals do not interrupt the cleaning up.

    Signals that are ignored, as under ``nohup``, or have another handler, are left unchanged.
    """

    def end(number: int, frame: Any) -> None:
        for other in handled:
            signal.signal(other, signal.SIG_IGN)
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


def restore_interrupts() -> None:
    """Make Ctrl-C raise KeyboardInterrupt again, once the command handles it."""
    if signal.getsignal(signal.SIGINT) is _end_quietly:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _end_quietly(*_: Any) -> None:
    try:
        os.write(2, b"\nbench: interrupted\n")
    finally:
        os._exit(130)


if sys.argv and Path(sys.argv[0]).name in PROGRAMS and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, _end_quietly)
