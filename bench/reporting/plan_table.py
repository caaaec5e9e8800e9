"""A plan for reading: its cells, where each stands and why, and how long what is to be computed may take."""

from __future__ import annotations

from collections.abc import Sequence

from bench.engine.plan import Planned
from bench.engine.progress import duration
from bench.reporting.terminal import table, wrapped
from bench.reporting.terminal_tables import described
from bench.store.store import Store

MOST_OF_WHY = 160


def counted(planned: Sequence[Planned]) -> str:
    """How many of a plan's cells are there already, and why the others are to be computed."""
    counts: dict[str, int] = {}
    for one in planned:
        state = f"{one.state.value}{'' if one.run or one.state.value == 'done' else ' (kept; retry=failed)'}"
        counts[state] = counts.get(state, 0) + 1
    return f"{len(planned)} cells: " + ", ".join(f"{n} {state}" for state, n in counts.items())


def listing(planned: Sequence[Planned], store: Store, workers: int) -> str:
    """A plan as a table, with an estimate of the time from what stored cells of each method took."""
    seconds, total, unknown, rows = store.fit_seconds(), 0.0, set(), []
    for one in planned:
        cell = one.cell
        each = seconds.get(cell.label)
        takes = "" if not one.run else "?" if each is None else f"{each * cell.replicates:.1f}"
        if one.run and each is None:
            unknown.add(cell.label)
        total += each * cell.replicates if one.run and each is not None else 0.0
        state = [one.state.value, takes, one.why[:MOST_OF_WHY]]
        rows.append([cell.identity[:8], cell.label, described(cell.scenario), str(cell.replicates), *state])
    headers = ["cell", "method", "scenario", "fits", "state", "s", "why"]
    wanted = [one for one in planned if one.run]
    lines = [table(rows, headers, (0, 1, 2, 4, 6)), "", wrapped(f"{counted(planned)}; {len(wanted)} to run")]
    if wanted:
        about = f"about {duration(total / workers)} on {workers} worker(s), as stored cells of the same methods took"
        lines.append(wrapped(about))
    if unknown:
        lines.append(wrapped(f"nothing known of {', '.join(sorted(unknown))}"))
    return "\n".join(lines)
