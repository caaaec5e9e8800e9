"""A run: the bounds of all cells that are wanted, then their fits; every cell becomes a stored row."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from bench.engine.cells import CellJob
from bench.engine.plan import Planned
from bench.engine.pool import Limits, TaskJob, run_jobs
from bench.engine.progress import Kind, OnLook
from bench.entrants.reference import REFERENCES
from bench.entrants.registry import load_method
from bench.isolation.failure import one_line
from bench.isolation.processes import Children
from bench.scoring.row import Rows
from bench.store.bounds import bound_path, keep_bound, kept_bound
from bench.store.cell import Cell
from bench.store.store import Store


@dataclass(frozen=True)
class BoundTask:
    """The bound of the scenario of a cell."""

    cell: Cell
    limit_s: float
    size: int = 1

    @property
    def key(self) -> str:
        """Return the identity of the bound."""
        return self.cell.bound_identity

    @property
    def kind(self) -> Kind:
        """Return the system's name: for each, much is compiled once."""
        return self.cell.scenario.label, "bound"

    def stored(self, folder: Path) -> bool:
        """Return whether the bound is kept."""
        return kept_bound(bound_path(self.cell, folder)) is not None

    def compute(self, folder: Path) -> None:
        """Compute and keep the bound."""
        keep_bound(self.cell, folder)


def run_cells(planned: Sequence[Planned], store: Store, limits: Limits, on_look: OnLook | None = None) -> None:
    """Compute and store the cells of a plan that are to be run.

    Raises InputError where the store can no longer be written; all that was stored stays.
    """
    wanted = [cell for cell in planned if cell.run]
    if not wanted:
        return
    with _children([planned.cell for planned in wanted], limits) as children:
        lost = make_bounds([planned.cell for planned in wanted], store, children, limits, on_look)
        jobs = [CellJob(cell, store, limits, unbounded=lost.get(cell.cell.identity, "")) for cell in wanted]
        run_jobs(jobs, store.claims, children, limits.workers, ("fit", "cell"), on_look)


def compute_bounds(cells: Sequence[Cell], store: Store, limits: Limits) -> dict[str, str]:
    """Have the store keep the bounds of some cells; see :func:`make_bounds`."""
    with _children(cells, limits) as children:
        return make_bounds(cells, store, children, limits)


def run_replicates(
    planned: Sequence[tuple[Planned, Collection[int]]], store: Store, limits: Limits, on_look: OnLook
) -> dict[str, Rows]:
    """Return the rows of some replicates of each cell, in order, by the cell's identity; nothing is stored.

    A cell that another run is at is waited for, and left out where that has stored it.
    """
    with _children([cell.cell for cell, _ in planned], limits) as children:
        jobs = [CellJob(cell, store, limits, replicates) for cell, replicates in planned]
        run_jobs(jobs, store.claims, children, limits.workers, ("fit", "cell"), on_look)
    return {job.key: job.scored.rows.sorted() for job in jobs if job.done == job.size}


def make_bounds(
    cells: Iterable[Cell], store: Store, children: Children, limits: Limits, on_look: OnLook | None = None
) -> dict[str, str]:
    """Have the store keep the bound of every cell, or as many as can be computed within the limits of a fit.

    Returns why a cell has no bound, by its identity: it costs the cells of its scenario, and no others. Raises
    InputError where the store cannot be written.
    """
    sharing: dict[str, list[Cell]] = defaultdict(list)
    lost = {}
    for cell in cells:
        try:
            sharing[cell.bound_identity].append(cell)
        except Exception as error:  # it draws the times of a scenario that may be absurd
            lost[cell.identity] = one_line(error)
    store.fetch_bounds(sharing.keys())
    tasks = [BoundTask(group[0], limits.timeout_s) for group in sharing.values()]
    jobs = [TaskJob(task, store.bounds, limits.memory_mb) for task in tasks if not task.stored(store.bounds)]
    if jobs:  # by one worker, since much is compiled once a process
        for bound, why in run_jobs(jobs, store.claims, children, 1, ("bound", ""), on_look).items():
            lost |= dict.fromkeys((cell.identity for cell in sharing[bound]), why)
    return {identity: f"its bound cannot be computed: {why}" for identity, why in lost.items()}


def _children(cells: Iterable[Cell], limits: Limits) -> Children:
    return Children(needed(limits.preload, {cell.method for cell in cells}))


def needed(packages: Sequence[str], methods: Collection[str]) -> list[str]:
    """Return those of the packages that a method requires and that are there."""
    required = {package for name in set(methods) - set(REFERENCES) for package in load_method(name).requires}
    return [package for package in packages if package in required and find_spec(package) is not None]
