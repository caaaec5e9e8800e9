"""A run: every cell that is wanted becomes a stored row, whatever its method does."""

from __future__ import annotations

import contextlib
import queue
import sys
from collections.abc import Callable, Collection, Iterator, Sequence
from importlib.util import find_spec
from typing import Any

from bench.entrants.reference import REFERENCES
from bench.entrants.registry import load_method
from bench.isolation.descriptors import affordable_workers
from bench.isolation.processes import Children
from bench.scoring.row import Row
from bench.store.cell import Cell
from bench.store.store import Store
from bench.sweep.bounds_process import make_bounds
from bench.sweep.plan import Planned
from bench.sweep.progress import FitsProgress, OnLook, firsts_first, kind_of
from bench.sweep.queue import CellQueue, QueuedCell, Waiting, queue_cell
from bench.sweep.workers import Limits, RunThread, Worker, Writer

WORKERS_A_WRITER = 4
COMPLETE_A_WRITER = 8
"""Cells that wait for a writer, at most: so many that it need not wait for the next, and few enough to be claimed."""

OnRows = Callable[[Cell, Sequence[Row]], None]
"""Is called with a cell and its rows, in order, when all that are wanted are there."""


def run_cells(planned: Sequence[Planned], store: Store, limits: Limits, on_look: OnLook | None = None) -> None:
    """Compute and store the cells of a plan that are to be run.

    Raises InputError where the store can no longer be written; all that was stored stays.
    """
    wanted = [one for one in planned if one.run]
    if not wanted:
        return
    with _children(limits, {one.cell.method for one in wanted}) as children:
        lost = make_bounds([one.cell for one in wanted], store, children, limits, on_look)
        cells = [queue_cell(one, store, limits.workers, unbounded=lost.get(one.cell.identity, "")) for one in wanted]
        _run(cells, store, children, limits, on_look)


def compute_bounds(cells: Sequence[Cell], store: Store, limits: Limits) -> dict[str, str]:
    """Have the store keep the bounds of some cells, as a sweep does before its fits.

    Returns why a cell has none, by its identity. Raises InputError where the store cannot be written.
    """
    with _children(limits, {cell.method for cell in cells}) as children:
        return make_bounds(cells, store, children, limits)


def run_replicates(
    planned: Sequence[tuple[Planned, Collection[int]]],
    store: Store,
    limits: Limits,
    on_rows: OnRows,
    on_look: OnLook,
) -> None:
    """Compute some replicates of each cell, and hand them over instead of storing them.

    Args:
        planned: Cells, each with the numbers of the wanted replicates.
        store: Where the cells are; a cell that another run is at is waited for, and left out where that has stored it.
        limits: Of the run.
        on_rows: Gets the rows of a cell as soon as they are complete, while the cell is claimed.
        on_look: Gets how far it is.
    """
    with _children(limits, {one.cell.method for one, _ in planned}) as children:
        cells = [queue_cell(one, store, limits.workers, replicates) for one, replicates in planned]
        _run(cells, store, children, limits, on_look, on_rows)


@contextlib.contextmanager
def _children(limits: Limits, methods: Collection[str]) -> Iterator[Children]:
    """The processes of a run; at its end all are ended."""
    children = Children(needed(limits.preload, methods))
    try:
        yield children
    finally:
        children.close()


def _run(
    queued: Sequence[QueuedCell],
    store: Store,
    children: Children,
    limits: Limits,
    on_look: OnLook | None,
    on_rows: OnRows | None = None,
) -> None:
    """Work cells off; with ``on_rows``, that gets what is complete instead of a writer."""
    n_workers = _affordable(limits.workers)
    n_writers = 0 if on_rows else -(-n_workers // WORKERS_A_WRITER)
    queued = firsts_first(queued, lambda one: kind_of(one.cell))
    cells = CellQueue(queued, store, COMPLETE_A_WRITER * max(1, n_writers))
    cells.claims.prepare()
    workers = [Worker(cells, children, limits) for _ in range(max(1, min(n_workers, cells.n_replicates)))]
    progress = _fits_progress(queued, len(workers))
    if on_look is not None:
        on_look(progress.begin())
    threads: list[RunThread] = [*workers, *(Writer(cells, children, limits, workers) for _ in range(n_writers))]
    try:
        for thread in threads:
            thread.start()
        while any(thread.is_alive() for thread in threads) or not cells.events.empty():
            with contextlib.suppress(queue.Empty):
                _deal_with(cells.events.get(timeout=0.1), progress, on_look)
            if on_rows is not None:
                _hand_over(cells, on_rows)
        if on_rows is not None:
            _hand_over(cells, on_rows)
    finally:
        cells.stop()
        children.close()
        cells.claims.release_all()


def _affordable(workers: int) -> int:
    """As many workers as there are descriptors for; says so where these are fewer than are wanted."""
    affordable = affordable_workers(workers)
    if affordable < workers:
        _say(f"{affordable} workers instead of {workers}: more need more open files than the system gives (ulimit -n)")
    return affordable


def _fits_progress(queued: Sequence[QueuedCell], workers: int) -> FitsProgress:
    return FitsProgress(
        left={one.cell.identity: one.open for one in queued},
        kinds={one.cell.identity: kind_of(one.cell) for one in queued},
        together={kind_of(one.cell): min(one.size, one.n_wanted) for one in queued},
        workers=workers,
    )


def _deal_with(event: Any, progress: FitsProgress, on_look: OnLook | None) -> None:
    if isinstance(event, BaseException):
        raise event
    if isinstance(event, Waiting):
        _say(str(event))
        return
    look = progress.fitted(event)
    if on_look is not None:
        on_look(look)


def _say(line: str) -> None:
    """A line on the error stream, above a progress bar if there is one."""
    from tqdm.auto import tqdm

    tqdm.write(f"bench: {line}", file=sys.stderr)


def _hand_over(cells: CellQueue, on_rows: OnRows) -> None:
    while not cells.complete.empty():
        queued = cells.complete.get()
        on_rows(queued.cell, sorted(queued.rows, key=lambda row: row.replicate))
        cells.close(queued)


def needed(packages: Sequence[str], methods: Collection[str]) -> list[str]:
    """Those of the packages that a method requires and that are there."""
    own = set(methods) - set(REFERENCES)
    required = {package for name in own for package in load_method(name).requires}
    return [package for package in packages if package in required and find_spec(package) is not None]
