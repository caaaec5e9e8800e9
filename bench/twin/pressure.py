"""Back-pressure: what becomes of samples that come faster than the method takes them, never silently.

``lag``: every sample is kept, up to a bounded queue; when it is full nothing more is read, so a pipe holds its writer
back. ``decimate``: while the queue is more than half full, only every second, fourth, ... sample enters it.
"""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Iterable
from typing import Literal

from bench.contract.online import Sample
from bench.twin.lines import Form

Policy = Literal["lag", "decimate"]
MOST_THINNED = 64
FULL, EMPTY = 0.5, 0.1
"""Parts of the queue from which samples come too fast, and below which the method has caught up."""


class Intake:
    """Reads lines in a thread and hands out samples; ``decimated`` and ``unreadable`` count what stayed behind."""

    def __init__(self, source: Iterable[str], form: Form, policy: Policy, size: int) -> None:
        self.source, self.form, self.policy = source, form, policy
        self.queue: queue.Queue[Sample | None] = queue.Queue(size)
        self.decimated, self.unreadable, self.thinned = 0, 0, 1
        self._late = self._ended = False
        self._error: Exception | None = None
        threading.Thread(target=self._read, daemon=True).start()

    @property
    def waiting(self) -> int:
        """Number of samples in the queue."""
        return max(self.queue.qsize() - self._ended, 0)

    def get(self) -> Sample | None:
        """Return the next sample, waited for; None at the end of the stream. Raises what reading it has raised."""
        while True:
            try:
                sample = self.queue.get(timeout=0.2)  # so that an interrupt is heard
            except queue.Empty:
                continue
            if sample is None and self._error is not None:
                raise self._error
            return sample

    def _read(self) -> None:
        seen = 0
        try:
            for text in self.source:
                sample = self.form.sample(text)
                if sample is None:
                    self._count_unreadable(text)
                    continue
                seen += 1
                self._adapt()
                if seen % self.thinned:
                    self.decimated += 1
                else:
                    self.queue.put(sample)
        except Exception as error:
            self._error = error  # raised where the samples are taken
        finally:
            self._ended = True
            self.queue.put(None)

    def _adapt(self) -> None:
        """Report that samples come too fast, and thin them out where that is the policy."""
        part = self.waiting / self.queue.maxsize
        if self.policy == "decimate":
            if part > FULL and self.thinned < MOST_THINNED:
                self.thinned *= 2
                report(f"samples arrive too fast to process: one in {self.thinned} is used (policy=decimate)")
            elif part < EMPTY and self.thinned > 1:
                self.thinned //= 2
                report(f"one sample in {self.thinned} is used")
        elif part > FULL and not self._late:
            self._late = True
            report(f"samples arrive too fast to process: {self.waiting} queued, all are used (policy=lag)")

    def _count_unreadable(self, text: str) -> None:
        if text.strip() and not text.lstrip().startswith("#"):
            self.unreadable += 1
            if str(self.unreadable).strip("0") == "1":  # 1, 10, 100, ...
                report(f"{self.unreadable} line(s) ignored, not of the form {self.form}: {text.strip()[:60]!r}")


def report(sentence: str) -> None:
    """Log a warning."""
    logging.getLogger("bench").warning(sentence)
