"""Back-pressure: handling of samples that arrive faster than the method processes them, with a message.

``lag``: all samples are queued; when the queue is full, reading stops, which blocks the writer of a pipe. ``decimate``:
while the queue is more than half full, only every second, fourth, ... sample is queued.
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
"""Fill levels of the queue above which samples arrive too fast, and below which the method has caught up."""


class Intake:
    """Reads lines in a thread and queues their samples; ``decimated`` and ``unreadable`` count the dropped lines."""

    def __init__(self, source: Iterable[str], form: Form, policy: Policy, size: int) -> None:
        self.source, self.form, self.policy = source, form, policy
        self.queue: queue.Queue[Sample | None] = queue.Queue(size)
        self.decimated, self.unreadable, self.thinned = 0, 0, 1
        self._late = self._ended = False
        self._error: Exception | None = None
        threading.Thread(target=self._read, daemon=True).start()

    @property
    def waiting(self) -> int:
        """The number of samples in the queue."""
        return max(self.queue.qsize() - self._ended, 0)

    def get(self) -> Sample | None:
        """Wait for the next sample; returns None at the end of the stream. Exceptions of the reader are raised here."""
        while True:
            try:
                sample = self.queue.get(timeout=0.2)  # a timeout lets Ctrl-C interrupt
            except queue.Empty:
                continue
            if sample is None and self._error is not None:
                raise self._error
            return sample

    def _read(self) -> None:
        count = 0
        try:
            for text in self.source:
                sample = self.form.sample(text)
                if sample is None:
                    self._count_unreadable(text)
                    continue
                count += 1
                self._adapt()
                if count % self.thinned:
                    self.decimated += 1
                else:
                    self.queue.put(sample)
        except Exception as error:
            self._error = error  # raised by get()
        finally:
            self._ended = True
            self.queue.put(None)

    def _adapt(self) -> None:
        """Report that samples arrive too fast, and decimate them if that is the policy."""
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
