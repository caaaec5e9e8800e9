"""A plan for reading: its cells, where each stands and why, and how long what is to be computed may take."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np

from bench.engine.plan import CellState, Planned
from bench.engine.progress import duration
from bench.reporting.terminal import table, wrapped
from bench.reporting.terminal_tables import described
from bench.store.store import Store

MOST_OF_WHY = 160


def counted(planned: Sequence[Planned]) -> str:
    """Say how many of a plan's cells are there already, and why the others are to be computed."""
    kept = " (kept; retry=failed)"
    counts = Counter(one.state.value + ("" if one.run or one.state is CellState.DONE else kept) for one in planned)
    return f"{len(planned)} cells: " + ", ".join(f"{n} {state}" for state, n in counts.items())


def listing(planned: Sequence[Planned], store: Store, workers: int) -> str:
    """Return a plan as a table, with an estimate of the time from what stored cells of each method took."""
    seconds = store.fit_seconds()
    wanted = [one.cell for one in planned if one.run]
    cost = {cell.identity: seconds.get(cell.label, math.nan) * cell.replicates for cell in wanted}
    rows = []
    for one in planned:
        known = one.cell.label in seconds
        takes = "" if not one.run else f"{cost[one.cell.identity]:.1f}" if known else "?"
        about = [one.cell.identity[:8], one.cell.label, described(one.cell.scenario), str(one.cell.replicates)]
        rows.append([*about, one.state.value, takes, one.why[:MOST_OF_WHY]])
    headers = ["cell", "method", "scenario", "fits", "state", "s", "why"]
    lines = [table(rows, headers, (0, 1, 2, 4, 6)), "", wrapped(f"{counted(planned)}; {len(wanted)} to run")]
    if wanted:
        total = duration(float(np.nansum(list(cost.values()))) / workers)
        lines.append(wrapped(f"about {total} on {workers} worker(s), as stored cells of the same methods took"))
    unknown = sorted({cell.label for cell in wanted} - set(seconds))
    return "\n".join([*lines, *([wrapped(f"nothing known of {', '.join(unknown)}")] if unknown else [])])
