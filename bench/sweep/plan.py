"""What of a sweep is there already, and what has to be computed, and why."""

from __future__ import annotations

import json
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from enum import StrEnum

from bench.contract.estimate import Status
from bench.entrants.registry import missing_package
from bench.errors import InputError
from bench.store.answers import Answer, answer_of, answers
from bench.store.cell import Cell
from bench.store.store import Store
from bench.store.version import Version

FAILURES = frozenset(Status) - {Status.OK, Status.UNSUPPORTED, Status.MISSING_DEPENDENCY}
"""What ``retry=failed`` tries again; a method that cannot take a problem will not be able to the next time either."""


class State(StrEnum):
    """Where a cell stands."""

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
    state: State
    why: str
    run: bool
    stamp: int = 0


def read_retry(text: str) -> frozenset[Status]:
    """The statuses that a command line wants tried again: ``none``, ``failed`` for all, or some by name.

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
    """Every cell once, in order.

    A cell whose file, or that of its arrays, is damaged or foreign is computed anew where all failures are tried again.
    Else a damaged file of a cell raises InputError; arrays are not looked at, since only pictures need them.
    """
    unique = {cell.identity: cell for cell in cells}
    stored = answers(store, unique)
    reasons = Reasons(store)
    return [_planned(cell, stored.get(identity), reasons, retry) for identity, cell in unique.items()]


def _planned(cell: Cell, stored: Answer | None, reasons: Reasons, retry: Collection[Status]) -> Planned:
    if stored is None:
        return Planned(cell, State.MISSING, "not computed yet", True)
    anew = set(retry) >= FAILURES
    damage = reasons.store.damage(cell.identity) if anew else stored.problem
    if damage and anew:
        return Planned(cell, State.DAMAGED, damage, True, stored.mtime_ns)
    if damage:  # said again, unless it was one of reading that has passed
        stamp = reasons.store.stamp(cell.identity)
        found = reasons.store.load(cell.identity)
        stored = answer_of(found, stamp) if found else Answer("", "", "{}", stamp)
    state, why = reasons.standing(cell.identity, cell.method, cell.version, stored.version, stored.statuses)
    if state is State.FAILED:
        counts = {Status(name) for name in json.loads(stored.statuses)}
        installable = Status.MISSING_DEPENDENCY in counts and missing_package(cell.method) is None
        return Planned(cell, state, why, installable or bool(counts & set(retry)), stored.mtime_ns)
    return Planned(cell, state, why, state is State.STALE, stored.mtime_ns)


class Reasons:
    """Where stored cells stand, and what has changed since they were computed; each version is compared once."""

    def __init__(self, store: Store) -> None:
        self.store = store
        self._known: dict[tuple[str, str], str] = {}

    def standing(self, identity: str, method: str, now: Version, digest: str, statuses: str) -> tuple[State, str]:
        """Say where a stored cell stands, and why.

        Args:
            identity: The cell's.
            method: Its method.
            now: What would compute it now.
            digest: Of the version that computed it.
            statuses: A JSON object of counts.
        """
        if digest != now.digest:
            return State.STALE, self._changed(identity, now, digest)
        counts = {Status(name): n for name, n in json.loads(statuses).items()}
        if Status.MISSING_DEPENDENCY in counts:
            return State.FAILED, missing_package(method) or "its package is installed now"
        total = sum(counts.values())
        why = ", ".join(f"{n} of {total} {status}" for status, n in counts.items() if status in FAILURES)
        return (State.FAILED, why) if why else (State.DONE, "")

    def _changed(self, identity: str, now: Version, digest: str) -> str:
        pair = now.digest, digest
        if pair not in self._known:
            stored = self.store.load(identity)
            self._known[pair] = now.changed_since(stored.version) if stored else "it is gone"
        return self._known[pair]
