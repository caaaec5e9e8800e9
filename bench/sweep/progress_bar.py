"""The progress of a run on the error stream: a bar in a terminal, else a line now and then; bounds first, then fits."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from bench.sweep.progress import Look, OnLook, duration

TICK_S = 0.5
"""How often a bar is drawn, so that the time goes on while a fit takes long."""
LINE_S = 30.0
"""Between two lines where there is no terminal."""


@contextmanager
def progress_bar(shown: bool = True) -> Iterator[OnLook]:
    """Show a run's progress on the error stream; what moves it on."""
    if not shown:
        yield lambda look: None
        return
    display = BarDisplay() if sys.stderr.isatty() else LineDisplay()
    try:
        yield display.show
    finally:
        display.close()


def described(look: Look, since: float, elapsed: float) -> str:
    """A look in words, what matters most first; ``since`` it, and ``elapsed`` since the beginning (s)."""
    parts = [left_text(look, since)] if look.done < look.total else []
    parts += [f"{look.cells_done}/{look.cells} cells"] if look.cells else []
    parts += [f"{look.done}/{look.total} {look.unit}s"]
    parts += [f"{look.failed} failed"] if look.failed else []
    parts += [f"{duration(elapsed)} so far" if look.done < look.total else f"in {duration(elapsed)}"]
    return ", ".join([*parts, look.what] if look.what and look.done < look.total else parts)


def left_text(look: Look, since: float) -> str:
    """The time left in words; it runs down between two looks."""
    if math.isnan(look.seconds_left):
        return "time left not known yet"
    left = look.seconds_left - since
    if left < 0:
        return "longer than expected" if not look.at_least else "time left not known yet"
    return f"{'at least' if look.at_least else 'about'} {duration(left)} left"


class LineDisplay:
    """A line now and then, and one at the end of each stage."""

    def __init__(self) -> None:
        self.look: Look | None = None
        self.started = self.said = time.monotonic()

    def show(self, look: Look) -> None:
        now = time.monotonic()
        if self.look is None or look.unit != self.look.unit:
            self.started = self.said = now
        self.look = look
        if look.done == look.total or now - self.said >= LINE_S:
            self.said = now
            percent = 100 * look.done // max(look.total, 1)
            print(f"bench: {look.unit}s {percent} %, {described(look, 0.0, now - self.started)}", file=sys.stderr)

    def close(self) -> None:
        """Nothing is left behind."""


class BarDisplay:
    """A bar for each stage, drawn by a thread of its own; the bars stay when they are full."""

    def __init__(self) -> None:
        self.look: Look | None = None
        self.bar: Any = None
        self.started = self.seen = time.monotonic()
        self._lock, self._over = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._tick, daemon=True)
        self._thread.start()

    def show(self, look: Look) -> None:
        with self._lock:
            new_stage = self.look is None or look.unit != self.look.unit
            self.look, self.seen = look, time.monotonic()
            if new_stage:
                self._open(look)
            if look.done == look.total:
                self._draw()

    def close(self) -> None:
        self._over.set()
        self._thread.join()
        with self._lock:
            if self.bar is not None:
                self._draw()
                self.bar.close()

    def _open(self, look: Look) -> None:
        from tqdm.auto import tqdm

        if self.bar is not None:
            self.bar.close()
        self.seen = self.started = time.monotonic()
        self.bar = tqdm(total=look.total, file=sys.stderr, dynamic_ncols=True, bar_format=self._format(look))

    def _tick(self) -> None:
        while not self._over.wait(TICK_S):
            with self._lock:
                if self.bar is not None:
                    self._draw()

    def _draw(self) -> None:
        assert self.look is not None
        self.bar.bar_format = self._format(self.look)
        self.bar.n = self.look.done
        self.bar.refresh()

    def _format(self, look: Look) -> str:
        now = time.monotonic()
        text = described(look, now - self.seen, now - self.started).replace("{", "{{").replace("}", "}}")
        return f"{look.unit}s {{percentage:3.0f}}%|{{bar}}| {text}"
