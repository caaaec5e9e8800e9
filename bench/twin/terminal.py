"""The twin in the terminal: quantities with their intervals, and how the last estimates ran."""

from __future__ import annotations

import os
import sys
import time
from collections import deque
from typing import Any

from bench.contract.online import Layout
from bench.reporting.rounding import readable, rounded
from bench.reporting.terminal import clipped

BARS = "▁▂▃▄▅▆▇█"
KEPT = 40
REFRESH_S = 0.1


class View:
    """Shows what is believed, in place on a terminal, else a line every five seconds; on the error stream."""

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self.runs: dict[str, deque[float]] = {q.name: deque(maxlen=KEPT) for q in layout.quantities}
        self.in_place = sys.stderr.isatty() and os.environ.get("TERM", "dumb") != "dumb"
        self.shown, self.due, self.each = 0, 0.0, 0
        self.last: dict[str, Any] | None = None

    def add(self, found: dict[str, Any]) -> None:
        """Take an answer in; show it when it is time."""
        self.each += 1
        if self.each % 10 == 1:
            for name, one in found["quantities"].items():
                self.runs[name].append(one["value"])
        now = time.monotonic()
        self.last = found
        if now >= self.due:
            self.due = now + (REFRESH_S if self.in_place else 5.0)
            self._show(found, whole=self.in_place)

    def close(self) -> None:
        """Show what stood at the end."""
        if self.last is not None:
            self._show(self.last, whole=True)

    def _show(self, found: dict[str, Any], whole: bool) -> None:
        lines = [clipped(text) for text in self._lines(found)]
        up = f"\x1b[{self.shown}F\x1b[J" if self.in_place and self.shown else ""
        sys.stderr.write(up + "\n".join(lines if whole else lines[:1]) + "\n")
        sys.stderr.flush()
        self.shown = len(lines)

    def _lines(self, found: dict[str, Any]) -> list[str]:
        bell = "  ALARM" if found["ringing"] else ""
        head = f"t = {found['t']:.3f} s  sample {found['sample']}  {found['status']} {found['message']}{bell}"
        lines = [f"{head}  waiting {found['waiting']}"]
        for name, one in found["quantities"].items():
            value, low, high = rounded(one["value"], one["low"], one["high"])
            told = f"{value} [{low}, {high}] {one['unit']}"
            lines.append(f"{readable(name):18} {told:44} {_bars(list(self.runs[name]))}")
        return lines


def _bars(values: list[float]) -> str:
    low, high = min(values, default=0.0), max(values, default=0.0)
    return "".join(BARS[int((len(BARS) - 1) * (v - low) / (high - low))] if high > low else BARS[3] for v in values)
