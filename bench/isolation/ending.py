"""SIGTERM and SIGHUP end a command as Ctrl-C does: what it has begun is cleared away."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from typing import Any

SIGNALS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))


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
        for own in taken:
            signal.signal(own, signal.SIG_IGN)
        raise Ended(number)

    in_main = threading.current_thread() is threading.main_thread()
    taken = [number for number in SIGNALS if in_main and signal.getsignal(number) is signal.SIG_DFL]
    for number in taken:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in taken:
            signal.signal(number, signal.SIG_DFL)
