"""A run: the bounds of all cells are computed first, then their fits; every cell is stored."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from bench.engine.cells import CellJob
from bench.engine.plan import Planned
from bench.engine.pool import Limits, TaskJob, run_jobs
from bench.engine.progress import Kind, OnProgress
from bench.entrants.reference import REFERENCES
from bench.entrants.registry import load_method
from bench.isolation.failure import one_line
from bench.isolation.processes import Children
from bench.scoring.row import Rows
from bench.store.bounds import bound_path, read_bound, store_bound
from bench.store.cell import Cell
from bench.store.store import Store


@dataclass(frozen=True)
class BoundTask:
    """Computation of the bound of a cell's scenario."""

    cell: Cell
    limit_s: float
    size: int = 1

    @property
    def key(self) -> str:
        """The identity of the bound."""
        return self.cell.bound_identity

    @property
    def kind(self) -> Kind:
        """The scenario's label: the cost is mostly the compilation for its system."""
        return self.cell.scenario.label, "bound"

    def stored(self, folder: Path) -> bool:
        """Return whether the bound is stored."""
        return read_bound(bound_path(self.cell, folder)) is not None

    def compute(self, folder: Path) -> None:
        """Compute and store the bound."""
        store_bound(self.cell, folder)


def run_cells(planned: Sequence[Planned], store: Store, limits: Limits, on_progress: OnProgress | None = None) -> None:
    """Compute and store the cells of a plan that are to be run.

    Raises:
        InputError: The store cannot be written; stored cells are kept.
    """
    planned = [cell for cell in planned if cell.run]
    if not planned:
        return
    with _children([item.cell for item in planned], limits) as children:
        failures = make_bounds([item.cell for item in planned], store, children, limits, on_progress)
        jobs = [CellJob(item, store, limits, unbounded=failures.get(item.cell.identity, "")) for item in planned]
        run_jobs(jobs, store.claims, children, limits.workers, ("fit", "cell"), on_progress)


def compute_bounds(cells: Sequence[Cell], store: Store, limits: Limits) -> dict[str, str]:
    """Compute and store the bounds of cells; see :func:`make_bounds`."""
    with _children(cells, limits) as children:
        return make_bounds(cells, store, children, limits)


def run_replicates(
    planned: Sequence[tuple[Planned, Collection[int]]], store: Store, limits: Limits, on_progress: OnProgress
) -> dict[str, Rows]:
    """Compute some replicates of each cell without storing them; returns their rows by the cell's identity.

    A cell that another run has claimed is waited for; if that run stores it, it is left out.
    """
    with _children([cell.cell for cell, _ in planned], limits) as children:
        jobs = [CellJob(cell, store, limits, replicates) for cell, replicates in planned]
        run_jobs(jobs, store.claims, children, limits.workers, ("fit", "cell"), on_progress)
    return {job.key: job.scored.rows.sorted() for job in jobs if job.done == job.size}


def make_bounds(
    cells: Iterable[Cell], store: Store, children: Children, limits: Limits, on_progress: OnProgress | None = None
) -> dict[str, str]:
    """Compute and store the bounds of cells, within the limits of a fit.

    Returns:
        The reason, by the identity of each cell whose bound could not be computed.

    Raises:
        InputError: The store cannot be written.
    """
    sharing: dict[str, list[Cell]] = defaultdict(list)
    reasons = {}
    for cell in cells:
        try:
            sharing[cell.bound_identity].append(cell)
        except Exception as error:  # drawing the times of an unreasonable scenario may fail
            reasons[cell.identity] = one_line(error)
    store.fetch_bounds(sharing.keys())
    tasks = [BoundTask(group[0], limits.timeout_s) for group in sharing.values()]
    jobs = [TaskJob(task, store.bounds, limits.memory_mb) for task in tasks if not task.stored(store.bounds)]
    if jobs:  # one worker only, since compilation is done once per process
        for bound, why in run_jobs(jobs, store.claims, children, 1, ("bound", ""), on_progress).items():
            reasons |= dict.fromkeys((cell.identity for cell in sharing[bound]), why)
    return {identity: f"the bound cannot be computed: {why}" for identity, why in reasons.items()}


def _children(cells: Iterable[Cell], limits: Limits) -> Children:
    return Children(needed(limits.preload, {cell.method for cell in cells}))


def needed(packages: Sequence[str], methods: Collection[str]) -> list[str]:
    """Return the packages that are installed and required by one of the methods."""
    required = {package for name in set(methods) - set(REFERENCES) for package in load_method(name).requires}
    return [package for package in packages if package in required and find_spec(package) is not None]
