"""Live display in the terminal: quantities with their intervals, and a small chart of the last estimates."""

from __future__ import annotations

import time
from collections import deque
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from bench.contract.online import Layout
from bench.reporting.rounding import readable, rounded

BARS = "▁▂▃▄▅▆▇█"
KEPT, EACH = 40, 10
"""Number of values in a chart, and number of samples between them."""
LINE_S = 5.0
"""Interval between lines if the output is not a terminal (s)."""


class View:
    """Displays the last report on the error stream: in place in a terminal, otherwise as a line every few seconds."""

    def __init__(self, layout: Layout) -> None:
        self.runs: dict[str, deque[float]] = {q.name: deque(maxlen=KEPT) for q in layout.quantities}
        self.report: dict[str, Any] = {}
        self.count, self.due = 0, 0.0
        self.console = Console(stderr=True)
        self.live = Live(
            console=self.console, get_renderable=self._table, refresh_per_second=10, redirect_stdout=False,
            redirect_stderr=False,
        )  # fmt: skip
        if self.console.is_terminal:
            self.live.start()

    def add(self, report: dict[str, Any]) -> None:
        """Add a report, and display it if it is due."""
        if self.count % EACH == 0:
            for name, interval in report["quantities"].items():
                self.runs[name].append(interval["value"])
        self.count, self.report = self.count + 1, report
        if not self.console.is_terminal and time.monotonic() >= self.due:
            self.due = time.monotonic() + LINE_S
            self.console.print(self._head())

    def close(self) -> None:
        """Display the last report."""
        if self.console.is_terminal:
            self.live.stop()
        elif self.report:
            self.console.print(self._table())

    def _head(self) -> Text:
        if not self.report:
            return Text("no samples yet")
        r = self.report
        bell = "  ALARM" if r["ringing"] else ""
        state = f"{r['status']} {r['message']}{bell}  waiting {r['waiting']}"
        return Text(f"t = {r['t']:.3f} s  sample {r['sample']}  {state}", overflow="ellipsis", no_wrap=True)

    def _table(self) -> Table:
        rows = Table.grid(padding=(0, 2))
        for name, interval in self.report.get("quantities", {}).items():
            value, low, high = rounded(interval["value"], interval["low"], interval["high"])
            rows.add_row(readable(name), Text(f"{value} [{low}, {high}] {interval['unit']}"), _bars(self.runs[name]))
        table = Table.grid()
        table.add_row(self._head())
        table.add_row(rows)
        return table


def _bars(values: deque[float]) -> str:
    low, high = min(values, default=0.0), max(values, default=0.0)
    return "".join(BARS[int((len(BARS) - 1) * (v - low) / (high - low))] if high > low else BARS[3] for v in values)
