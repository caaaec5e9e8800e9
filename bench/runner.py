"""A run: every cell that is wanted becomes a stored row, whatever its method does."""

from __future__ import annotations

import multiprocessing
import queue
from collections.abc import Callable, Collection, Sequence
from importlib.util import find_spec

from bench.board import Board, work_of
from bench.bound import bound_identity, load_bounds
from bench.cell import Cell
from bench.plan import Planned
from bench.processes import Children
from bench.reference import REFERENCES
from bench.registry import load_method
from bench.slots import Hand, Limits, Slot, Writer
from bench.store import Store

SLOTS_A_WRITER = 4

Progress = Callable[[Cell, int], None]


def run_cells(planned: Sequence[Planned], store: Store, limits: Limits, on_progress: Progress | None = None) -> None:
    """Compute and store the cells of a plan that are to be run.

    ``on_progress(cell, n)`` is called when ``n`` more replicates of a cell are done. Raises InputError where the store
    can no longer be written; all that was stored stays.
    """
    wanted = [one for one in planned if one.run]
    if not wanted:
        return
    _make_bounds(wanted, store)
    board = Board([work_of(one, store, limits.workers) for one in wanted], store)
    children = Children(needed(limits.preload, {one.cell.method for one in wanted}))
    slots = [Slot(board, children, limits) for _ in range(max(1, min(limits.workers, board.batches)))]
    writers = [Writer(board, children, limits, slots) for _ in range(-(-len(slots) // SLOTS_A_WRITER))]
    hands: list[Hand] = [*slots, *writers]
    try:
        for hand in hands:
            hand.start()
        while any(hand.is_alive() for hand in hands) or not board.events.empty():
            try:
                event = board.events.get(timeout=0.1)
            except queue.Empty:
                continue
            if isinstance(event, BaseException):
                raise event
            if on_progress is not None:
                on_progress(*event)
    finally:
        board.stop()
        children.close()
        board.claims.release_all()


def _make_bounds(wanted: Sequence[Planned], store: Store) -> None:
    """The bounds of all cells, in the store; an interrupt does not wait for the process that computes them."""
    try:
        store.fetch_bounds({bound_identity(one.cell.scenario, one.cell.seed) for one in wanted})
        load_bounds([(one.cell.scenario, one.cell.seed) for one in wanted], store.bounds)
    except KeyboardInterrupt:
        for child in multiprocessing.active_children():
            child.kill()
        raise


def needed(packages: Sequence[str], methods: Collection[str]) -> list[str]:
    """Those of the packages that a method requires and that are there."""
    own = set(methods) - set(REFERENCES)
    required = {package for name in own for package in load_method(name).requires}
    return [package for package in packages if package in required and find_spec(package) is not None]
