"""The bounds of a run's cells, computed before the fits, in a process of the pool and within the limits of a fit.

A bound that cannot be computed costs the cells of its scenario, and no others.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from bench.engine.pool import Limits, QueuedTask, run_queued
from bench.engine.progress import Kind, OnLook
from bench.isolation.failure import one_line
from bench.isolation.processes import Children
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


def make_bounds(
    cells: Iterable[Cell], store: Store, children: Children, limits: Limits, on_look: OnLook | None = None
) -> dict[str, str]:
    """Have the store keep the bound of every cell, or as many as can be computed.

    Args:
        cells: The cells.
        store: Where the bounds are kept.
        children: The processes of the run.
        limits: Of one bound.
        on_look: Called with the progress, where any bound is missing.

    Returns:
        Why a cell has no bound, by the identity of the cell.

    Raises:
        InputError: where the store cannot be written.
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
    queued = [QueuedTask(task, store.bounds, limits) for task in tasks if not task.stored(store.bounds)]
    if queued:  # by one worker, since much is compiled once a process
        for bound, why in run_queued(queued, store.claims, children, 1, ("bound", ""), on_look).items():
            lost |= dict.fromkeys((cell.identity for cell in sharing[bound]), why)
    return {identity: f"its bound cannot be computed: {why}" for identity, why in lost.items()}
