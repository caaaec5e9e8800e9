"""A run: every cell that is wanted becomes a stored row, whatever its method does."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from importlib.util import find_spec

from bench.engine.pool import Limits, run_queued
from bench.engine.progress import OnLook
from bench.entrants.reference import REFERENCES
from bench.entrants.registry import load_method
from bench.isolation.processes import Children
from bench.store.cell import Cell
from bench.store.store import Store
from bench.sweep.bounds import make_bounds
from bench.sweep.cells import OnRows, queue_cell
from bench.sweep.plan import Planned


def run_cells(planned: Sequence[Planned], store: Store, limits: Limits, on_look: OnLook | None = None) -> None:
    """Compute and store the cells of a plan that are to be run.

    Raises InputError where the store can no longer be written; all that was stored stays.
    """
    wanted = [one for one in planned if one.run]
    if not wanted:
        return
    with Children(needed(limits.preload, {one.cell.method for one in wanted})) as children:
        lost = make_bounds([one.cell for one in wanted], store, children, limits, on_look)
        cells = [queue_cell(one, store, limits, unbounded=lost.get(one.cell.identity, "")) for one in wanted]
        run_queued(cells, store.claims, children, limits.workers, ("fit", "cell"), on_look, written=True)


def compute_bounds(cells: Sequence[Cell], store: Store, limits: Limits) -> dict[str, str]:
    """Have the store keep the bounds of some cells, as a sweep does before its fits.

    Returns why a cell has none, by its identity. Raises InputError where the store cannot be written.
    """
    with Children(needed(limits.preload, {cell.method for cell in cells})) as children:
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
        on_look: Called with the progress.
    """
    with Children(needed(limits.preload, {one.cell.method for one, _ in planned})) as children:
        cells = [queue_cell(one, store, limits, replicates, on_rows=on_rows) for one, replicates in planned]
        run_queued(cells, store.claims, children, limits.workers, ("fit", "cell"), on_look)


def needed(packages: Sequence[str], methods: Collection[str]) -> list[str]:
    """Return those of the packages that a method requires and that are there."""
    own = set(methods) - set(REFERENCES)
    required = {package for name in own for package in load_method(name).requires}
    return [package for package in packages if package in required and find_spec(package) is not None]
