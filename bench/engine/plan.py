"""The plan of a sweep: which cells are there already, which are to be computed, and why."""

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
from bench.store.stored import CellHead
from bench.store.version import Version

FAILURES = frozenset(Status) - {Status.OK, Status.UNSUPPORTED, Status.MISSING_DEPENDENCY}
"""What ``retry=failed`` tries again; a method that cannot take a problem will not be able to the next time either."""


class CellState(StrEnum):
    """States of a cell in the store."""

    DONE = "done"
    MISSING = "missing"
    STALE = "stale"
    FAILED = "failed"
    DAMAGED = "damaged"


@dataclass(frozen=True)
class Planned:
    """A cell, where it stands and why; ``run`` says whether it is to be computed.

    ``stamp``: when its file was written as it stood then (ns; 0 where there was none). A run that finds another has
    nothing left to do: somebody else has stored the cell since.
    """

    cell: Cell
    state: CellState
    why: str
    run: bool
    stamp: int = 0

    @property
    def key(self) -> str:
        """Return the identity of the cell."""
        return self.cell.identity

    def stored(self, folder: Path) -> bool:
        """Return whether a store has another file of the cell than the plan has seen."""
        return Store(folder).stamp(self.key) not in (0, self.stamp)


def read_retry(text: str) -> frozenset[Status]:
    """Return the statuses that a command line wants tried again: ``none``, ``failed`` for all, or some by name.

    With all of them go the cells whose files are damaged.
    """
    if text == "none":
        return frozenset()
    if text == "failed":
        return FAILURES
    names = [part.strip() for part in text.split(",")]
    if not set(names) <= FAILURES:
        raise InputError("retry", text, f"none, failed, or of: {', '.join(sorted(FAILURES))}")
    return frozenset(Status(name) for name in names)


def plan(cells: Sequence[Cell], store: Store, retry: Collection[Status] = ()) -> list[Planned]:
    """Return every cell once, in order.

    A cell whose file, or that of its arrays, is damaged or foreign is computed anew where all failures are tried again.
    Else a damaged file of a cell raises InputError; arrays are not looked at, since only pictures need them.
    """
    unique = {cell.identity: cell for cell in cells}
    return [_planned(cell, store, retry) for cell in unique.values()]


def _planned(cell: Cell, store: Store, retry: Collection[Status]) -> Planned:
    anew = set(retry) >= FAILURES
    damage = store.damage(cell.identity) if anew else ""
    if damage:
        return Planned(cell, CellState.DAMAGED, damage, True, store.stamp(cell.identity))
    stored = store.head(cell.identity)
    if stored is None:
        return Planned(cell, CellState.MISSING, "not computed yet", True)
    state, why = standing(stored, cell.method, cell.version)
    if state is CellState.FAILED:
        counts = set(map(Status, stored.statuses))
        installable = Status.MISSING_DEPENDENCY in counts and missing_package(cell.method) is None
        return Planned(cell, state, why, installable or bool(counts & set(retry)), stored.stamp)
    return Planned(cell, state, why, state is CellState.STALE, stored.stamp)


def standing(stored: CellHead, method: str, today: Version) -> tuple[CellState, str]:
    """Say whether a stored cell is current, and why not.

    Args:
        stored: The cell.
        method: Its method.
        today: The version that would compute it today.
    """
    if not today.is_that_of(stored.version):
        return CellState.STALE, today.changed_since(stored.version)
    if Status.MISSING_DEPENDENCY in stored.statuses:
        return CellState.FAILED, missing_package(method) or "its package is installed now"
    counts = stored.statuses.items()
    why = ", ".join(f"{n} of {stored.replicates} {Status(name)}" for name, n in counts if name in FAILURES)
    return (CellState.FAILED, why) if why else (CellState.DONE, "")
