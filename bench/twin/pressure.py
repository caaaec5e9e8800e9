"""Back-pressure: what becomes of samples that come faster than the method takes them, never silently.

``lag``: every sample is kept, up to a bounded queue; when it is full nothing more is read, so a pipe holds its writer
back. ``decimate``: while the queue is more than half full, only every second, fourth, ... sample enters it.
"""

from __future__ import annotations

import queue
import sys
import threading
from collections.abc import Iterable
from typing import Literal

from bench.contract.online import Sample
from bench.twin.lines import Form

Policy = Literal["lag", "decimate"]
MOST_THINNED = 64
END = None


class Intake:
    """Reads lines in a thread and hands out samples; ``decimated`` and ``unreadable`` count what stayed behind."""

    def __init__(self, source: Iterable[str], form: Form, policy: Policy, size: int) -> None:
        self.source, self.form, self.policy = source, form, policy
        self.queue: queue.Queue[Sample | None] = queue.Queue(size)
        self.size, self.decimated, self.unreadable, self.thinned = size, 0, 0, 1
        self._said_full = self._ended = False
        self._error: Exception | None = None
        threading.Thread(target=self._read, daemon=True).start()

    @property
    def waiting(self) -> int:
        """Samples in the queue."""
        return max(self.queue.qsize() - self._ended, 0)

    def get(self) -> Sample | None:
        """The next sample, waited for; None at the end of the stream. Raises what reading it has raised."""
        while True:
            try:
                found = self.queue.get(timeout=0.2)  # so that an interrupt is heard
            except queue.Empty:
                continue
            if found is END and self._error is not None:
                raise self._error
            return found

    def _read(self) -> None:
        seen = 0
        try:
            for text in self.source:
                sample = self.form.sample(text)
                if sample is None:
                    self._unread(text)
                    continue
                seen += 1
                self._press()
                if self.policy == "decimate" and seen % self.thinned:
                    self.decimated += 1
                else:
                    self.queue.put(sample)
        except Exception as error:
            self._error = error  # raised where the samples are taken
        finally:
            self._ended = True
            self.queue.put(END)

    def _press(self) -> None:
        """Say that samples come too fast, and thin them out where that is the policy."""
        full = self.waiting / self.size
        if self.policy == "decimate":
            if full > 0.5 and self.thinned < MOST_THINNED:
                self.thinned *= 2
                _say(f"samples come faster than the method: one sample in {self.thinned} is taken (policy=decimate)")
            elif full < 0.1 and self.thinned > 1:
                self.thinned //= 2
                _say(f"one sample in {self.thinned} is taken" if self.thinned > 1 else "every sample is taken again")
        elif full > 0.5 and not self._said_full:
            self._said_full = True
            _say(f"samples come faster than the method: {self.waiting} wait, none is left out (policy=lag)")
        elif full < 0.1 and self._said_full:
            self._said_full = False
            _say("the method has caught up")

    def _unread(self, text: str) -> None:
        if text.strip() and not text.lstrip().startswith("#"):
            self.unreadable += 1
            if self.unreadable in (1, 10, 100, 1000) or self.unreadable % 10_000 == 0:
                _say(f"{self.unreadable} line(s) left out that do not read {self.form.columns}: {text.strip()[:60]!r}")


def _say(sentence: str) -> None:
    print(f"bench track: {sentence}", file=sys.stderr, flush=True)
