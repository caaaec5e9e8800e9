"""Recompute replicates of stored cells, and compare their scores with the stored ones."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np

from bench.config.fields import MOST_MEMORY_MB, MOST_TIMEOUT_S
from bench.engine.launch import preloaded
from bench.engine.plan import CellState, Planned
from bench.engine.pool import Limits
from bench.engine.progress import progress_bar
from bench.engine.runner import run_replicates
from bench.scoring.row import Row, Rows
from bench.scoring.traces import depends_on_clock
from bench.store.cell import Cell
from bench.store.store import Store
from bench.store.stored_cell import StoredCell

SAME = 1e-4
"""Relative difference up to which two scores are the same: stored ones keep five significant digits, tables three."""
TOLERANCE = 1e-3
"""Largest relative difference of a score that is in no table."""
HIT_ONE_IN = 20
"""The probability of a missed change is stated for a change of one replicate in this number (5 %)."""


def recompute(chosen: Sequence[tuple[Cell, Collection[int]]], limits: Limits) -> dict[str, Rows]:
    """Compute some replicates of each cell; returns their rows in order, by identity of the cell."""
    with tempfile.TemporaryDirectory() as folder, progress_bar() as on_progress:
        store = Store(Path(folder))
        planned = [(Planned(cell, CellState.MISSING, "", True), replicates) for cell, replicates in chosen]
        return run_replicates(planned, store, limits, on_progress)


def widest_limits(cells: Sequence[StoredCell], workers: int) -> Limits:
    """Return the widest limits that any of the cells states and a run accepts, with a number of workers."""
    stated = [stored.provenance.get("limits", {}) for stored in cells]
    widest = {
        name: max([getattr(Limits(), name), *(limit for part in stated if (limit := float(part.get(name, 0))) <= most)])
        for name, most in (("timeout_s", MOST_TIMEOUT_S), ("memory_mb", MOST_MEMORY_MB))
    }
    return Limits(workers, **widest, preload=preloaded())


def score_differences(before: Sequence[Row], again: Sequence[Row], cell: Sequence[Row]) -> dict[str, float]:
    """Return the largest relative difference of each score that does not depend on the speed of the machine.

    Args:
        before: Stored replicates.
        again: The same replicates, computed again.
        cell: All replicates of the stored cell. A difference is relative to the score, or to its median size over these
            where that is larger: an error that is next to nothing by luck has no digits of its own.
    """
    old, new, whole = map(Rows.from_rows, (before, again, cell))
    differences = {}
    for name in dict.fromkeys([*old.score_names, *new.score_names]):
        if not depends_on_clock(name):
            a, b, sizes = old.scores(name), new.scores(name), np.abs(whole.scores(name))
            size = float(np.median(sizes[np.isfinite(sizes)])) if np.any(np.isfinite(sizes)) else 0.0
            same = (a == b) | (np.isnan(a) & np.isnan(b))
            with np.errstate(invalid="ignore", divide="ignore"):
                gaps = np.abs(a - b) / np.maximum(np.maximum(np.abs(a), np.abs(b)), size)
            differences[name] = float(np.max(np.where(same, 0.0, np.where(np.isfinite(gaps), gaps, np.inf))))
    return differences


def difference(before: Sequence[Row], again: Sequence[Row], cell: Sequence[Row]) -> float:
    """Return the largest of :func:`score_differences`.

    Infinite if a replicate has another status. Messages are not compared, since their wording may be improved.
    """
    old, new = ([row.status for row in rows] for rows in (before, again))
    return max(score_differences(before, again, cell).values(), default=0.0) if old == new else math.inf


def miss_probability(n: int, compared: int) -> float:
    """Return the probability that ``compared`` of ``n`` replicates, drawn without replacement, hold no changed one.

    5 % of the replicates, rounded up, are changed: the hypergeometric distribution at zero (W. Feller, An Introduction
    to Probability Theory and Its Applications, vol. 1, 3rd ed., 1968, section II.6).
    """
    changed = -(-n // HIT_ONE_IN)
    return math.comb(n - changed, compared) / math.comb(n, compared)
