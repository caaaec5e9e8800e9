"""A run: every cell that is wanted becomes a stored row, whatever its method does."""

from __future__ import annotations

import contextlib
import multiprocessing
import queue
from collections.abc import Callable, Collection, Sequence
from importlib.util import find_spec

from bench.entrants.reference import REFERENCES
from bench.entrants.registry import load_method
from bench.isolation.processes import Children
from bench.scoring.row import Row
from bench.store.bounds import load_bounds
from bench.store.cell import Cell
from bench.store.store import Store
from bench.sweep.plan import Planned
from bench.sweep.queue import CellQueue, queue_cell
from bench.sweep.workers import Limits, RunThread, Worker, Writer

WORKERS_A_WRITER = 4

Progress = Callable[[Cell, int], None]
"""Is called with a cell and a number when so many more of its replicates are done."""
OnRows = Callable[[Cell, Sequence[Row]], None]
"""Is called with a cell and its rows, in order, when all that are wanted are there."""


def run_cells(planned: Sequence[Planned], store: Store, limits: Limits, on_progress: Progress | None = None) -> None:
    """Compute and store the cells of a plan that are to be run.

    Raises InputError where the store can no longer be written; all that was stored stays.
    """
    wanted = [one for one in planned if one.run]
    if wanted:
        _make_bounds(wanted, store)
        _run(CellQueue([queue_cell(one, store, limits.workers) for one in wanted], store), limits, on_progress)


def run_replicates(
    planned: Sequence[tuple[Planned, Collection[int]]],
    store: Store,
    limits: Limits,
    on_rows: OnRows,
    on_progress: Progress,
) -> None:
    """Compute some replicates of each cell, and hand them over instead of storing them.

    Args:
        planned: Cells, each with the numbers of the wanted replicates.
        store: Where the cells are; a cell that another run is at is waited for, and left out where that has stored it.
        limits: Of the run.
        on_rows: Gets the rows of a cell as soon as they are complete.
        on_progress: Gets what is done.
    """
    cells = [queue_cell(one, store, limits.workers, replicates) for one, replicates in planned]
    _run(CellQueue(cells, store), limits, on_progress, on_rows)


def _run(cells: CellQueue, limits: Limits, on_progress: Progress | None, on_rows: OnRows | None = None) -> None:
    """Work a queue off; with ``on_rows``, that gets what is complete instead of a writer."""
    children = Children(needed(limits.preload, cells.methods))
    workers = [Worker(cells, children, limits) for _ in range(max(1, min(limits.workers, cells.n_replicates)))]
    n_writers = 0 if on_rows else -(-len(workers) // WORKERS_A_WRITER)
    threads: list[RunThread] = [*workers, *(Writer(cells, children, limits, workers) for _ in range(n_writers))]
    try:
        for thread in threads:
            thread.start()
        while any(thread.is_alive() for thread in threads) or not cells.events.empty():
            with contextlib.suppress(queue.Empty):
                event = cells.events.get(timeout=0.1)
                if isinstance(event, BaseException):
                    raise event
                if on_progress is not None:
                    on_progress(*event)
            if on_rows is not None:
                _hand_over(cells, on_rows)
        if on_rows is not None:
            _hand_over(cells, on_rows)
    finally:
        cells.stop()
        children.close()
        cells.claims.release_all()


def _hand_over(cells: CellQueue, on_rows: OnRows) -> None:
    while not cells.complete.empty():
        queued = cells.complete.get()
        on_rows(queued.cell, sorted(queued.rows, key=lambda row: row.replicate))
        cells.close(queued)


def _make_bounds(wanted: Sequence[Planned], store: Store) -> None:
    """The bounds of all cells, in the store; an interrupt does not wait for the process that computes them."""
    different = {one.cell.bound_identity: one.cell for one in wanted}
    try:
        store.fetch_bounds(different.keys())
        load_bounds(list(different.values()), store.bounds)
    except KeyboardInterrupt:
        for child in multiprocessing.active_children():
            child.kill()
        raise


def needed(packages: Sequence[str], methods: Collection[str]) -> list[str]:
    """Those of the packages that a method requires and that are there."""
    own = set(methods) - set(REFERENCES)
    required = {package for name in own for package in load_method(name).requires}
    return [package for package in packages if package in required and find_spec(package) is not None]
