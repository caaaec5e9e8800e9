"""The plan of a sweep: the state of each cell in the store, and whether and why it is computed."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from bench.contract.estimate import Status
from bench.entrants.registry import missing_package
from bench.errors import InputError
from bench.store.cell import Cell
from bench.store.store import Store
from bench.store.stored_cell import CellHead
from bench.store.version import Version

FAILURES = frozenset(Status) - {Status.OK, Status.UNSUPPORTED, Status.MISSING_DEPENDENCY}
"""Statuses that ``retry=failed`` repeats; an unsupported problem remains unsupported."""


class CellState(StrEnum):
    """States of a cell in the store."""

    DONE = "done"
    MISSING = "missing"
    STALE = "stale"
    FAILED = "failed"
    DAMAGED = "damaged"


@dataclass(frozen=True)
class Planned:
    """A cell with its state in the store, the reason, and whether it is to be computed (``run``).

    ``stamp`` is the time at which its file was written (ns; 0 if there was none). A different stamp later shows that
    another run has stored the cell since.
    """

    cell: Cell
    state: CellState
    why: str
    run: bool
    stamp: int = 0

    @property
    def key(self) -> str:
        """The identity of the cell."""
        return self.cell.identity

    def stored(self, folder: Path) -> bool:
        """Return whether the cell has been stored since the plan was made."""
        return Store(folder).stamp(self.key) not in (0, self.stamp)


def read_retry(text: str) -> frozenset[Status]:
    """Parse the statuses to repeat: ``none``, ``failed`` for all, or some by name; raises InputError."""
    if text == "none":
        return frozenset()
    if text == "failed":
        return FAILURES
    names = [part.strip() for part in text.split(",")]
    if not set(names) <= FAILURES:
        raise InputError("retry", text, f"use none, failed, or some of: {', '.join(sorted(FAILURES))}")
    return frozenset(Status(name) for name in names)


def plan(cells: Sequence[Cell], store: Store, retry: Collection[Status] = ()) -> list[Planned]:
    """Return the plan of the cells, each once, in order.

    If all failures are repeated, a cell whose file is damaged or invalid is computed again. Otherwise a damaged file
    raises InputError; arrays are not checked then, since only figures use them.
    """
    unique = {cell.identity: cell for cell in cells}
    return [_planned(cell, store, retry) for cell in unique.values()]


def _planned(cell: Cell, store: Store, retry: Collection[Status]) -> Planned:
    damage = store.damage(cell.identity) if set(retry) >= FAILURES else ""
    if damage:
        return Planned(cell, CellState.DAMAGED, damage, True, store.stamp(cell.identity))
    stored = store.head(cell.identity)
    if stored is None:
        return Planned(cell, CellState.MISSING, "not computed yet", True)
    state, why = cell_state(stored, cell.method, cell.version)
    if state is CellState.FAILED:
        counts = set(map(Status, stored.statuses))
        installable = Status.MISSING_DEPENDENCY in counts and missing_package(cell.method) is None
        return Planned(cell, state, why, installable or bool(counts & set(retry)), stored.stamp)
    return Planned(cell, state, why, state is CellState.STALE, stored.stamp)


def cell_state(stored: CellHead, method: str, today: Version) -> tuple[CellState, str]:
    """Return the state of a stored cell and the reason.

    Args:
        stored: The stored cell.
        method: Its method.
        today: The version that would compute it now.
    """
    if not today.matches(stored.version):
        return CellState.STALE, today.changed_since(stored.version)
    if Status.MISSING_DEPENDENCY in stored.statuses:
        return CellState.FAILED, missing_package(method) or "its package is installed now"
    counts = stored.statuses.items()
    why = ", ".join(f"{n} of {stored.replicates} {Status(name)}" for name, n in counts if name in FAILURES)
    return (CellState.FAILED, why) if why else (CellState.DONE, "")
