"""Recompute replicates of stored cells."""

from __future__ import annotations

import tempfile
from collections.abc import Collection, Sequence
from pathlib import Path

from bench.config.fields import MOST_MEMORY_MB, MOST_TIMEOUT_S
from bench.engine.launch import preloaded
from bench.engine.plan import CellState, Planned
from bench.engine.pool import Limits
from bench.engine.progress import progress_bar
from bench.engine.runner import run_replicates
from bench.scoring.row import Rows
from bench.store.cell import Cell
from bench.store.store import Store
from bench.store.stored_cell import StoredCell


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
