"""A plan in the terminal: its cells with their state and why, or a summary by method, and an estimate of the time."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np

from bench.engine.plan import CellState, Planned
from bench.engine.progress import duration
from bench.reporting.frame import group
from bench.reporting.sweep_summary import MOST_ROWS
from bench.reporting.terminal import table, wrapped
from bench.reporting.terminal_tables import described
from bench.store.store import Store

LONGEST_REASON = 160


def counted(planned: Sequence[Planned]) -> str:
    """Count the cells of a plan by state: done, missing, stale, failed."""
    counts = Counter(_state(item) for item in planned)
    return f"{len(planned)} cells: " + ", ".join(f"{n} {state}" for state, n in counts.items())


def listing(planned: Sequence[Planned], store: Store, workers: int, every_cell: bool = False) -> str:
    """Tabulate a plan: its cells where they are few or wanted, else its methods; with an estimate of the time.

    The estimate rests on the mean time that stored fits of the same method took.
    """
    seconds = store.fit_seconds()
    to_run = [item.cell for item in planned if item.run]
    cost = {cell.identity: seconds.get(cell.label, math.nan) * cell.replicates for cell in to_run}
    shown = _cells if every_cell or len(planned) <= MOST_ROWS else _methods
    lines = [shown(planned, cost), "", wrapped(f"{counted(planned)}; {len(to_run)} to run")]
    unknown = sorted({cell.label for cell in to_run} - set(seconds))
    if not np.isnan(list(cost.values())).all():
        total = f"{'at least' if unknown else 'about'} {duration(float(np.nansum(list(cost.values()))) / workers)}"
        lines.append(wrapped(f"{total} with {workers} worker(s), by the time of stored fits of the same methods"))
    return "\n".join([*lines, *([wrapped(f"time unknown: {', '.join(unknown)}")] if unknown else [])])


def _cells(planned: Sequence[Planned], cost: dict[str, float]) -> str:
    rows = []
    for item in planned:
        cell = item.cell
        time = _seconds(cost[cell.identity]) if item.run else ""
        row = [cell.identity[:8], cell.label, described(cell.scenario), str(cell.replicates)]
        rows.append([*row, item.state.value, time, item.why[:LONGEST_REASON]])
    return table(rows, ["cell", "method", "scenario", "fits", "state", "s", "why"], (0, 1, 2, 4, 6))


def _methods(planned: Sequence[Planned], cost: dict[str, float]) -> str:
    states = list(dict.fromkeys(_state(item) for item in planned))
    rows = []
    for method, items in group(planned, lambda item: item.cell.label).items():
        counts = Counter(_state(item) for item in items)
        to_run = [item.cell for item in items if item.run]
        total = _seconds(sum(cost[cell.identity] for cell in to_run)) if to_run else ""
        fits = str(sum(item.cell.replicates for item in items))
        rows.append([method, str(len(items)), fits, *(str(counts[state] or "") for state in states), total])
    return table(rows, ["method", "cells", "fits", *states, "s"])


def _state(item: Planned) -> str:
    return item.state.value + ("" if item.run or item.state is CellState.DONE else " (kept; retry=failed)")


def _seconds(cost: float) -> str:
    return "?" if math.isnan(cost) else f"{cost:.1f}"
