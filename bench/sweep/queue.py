"""What a run has to do, and how far it is: cells, the replicates of each that are still to be fitted, their rows."""

from __future__ import annotations

import pickle
import queue
import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bench.contract.estimate import Status
from bench.entrants.reference import REFERENCES
from bench.entrants.registry import make_method, missing_package
from bench.isolation.failure import without_places
from bench.scoring.row import Row
from bench.store.cell import Cell
from bench.store.locks import Claims
from bench.store.store import Store
from bench.sweep import method_process as fitter
from bench.sweep.plan import FAILURES, Planned, State
from bench.sweep.scoring_process import Scored

LARGEST_TASK = 5
"""Replicates that a method gets at once, at most: what is lost, and tried again one by one, when a process dies."""
WAIT_S = 0.5


@dataclass
class Work:
    """A cell under way."""

    cell: Cell
    fit: bytes
    requires: tuple[str, ...]
    pending: deque[tuple[int, ...]]
    stamp: int
    rows: list[Row] = field(default_factory=list)
    tracebacks: dict[int, str] = field(default_factory=dict)
    arrays: dict[str, np.ndarray] = field(default_factory=dict)
    facts: dict[str, Any] = field(default_factory=dict)
    started: float = 0.0

    @property
    def complete(self) -> bool:
        return len(self.rows) == self.cell.replicates

    def errors(self) -> str:
        """The tracebacks of all failed replicates, in order."""
        parts = [f"replicate {i}\n{text.rstrip()}\n" for i, text in sorted(self.tracebacks.items()) if text.strip()]
        return without_places("\n".join(parts))


def work_of(planned: Planned, store: Store, workers: int) -> Work:
    """The replicates to be fitted: all of them, or those that failed where a cell is tried again."""
    cell = planned.cell
    requires: tuple[str, ...] = ()
    if cell.method in REFERENCES:
        fit: Any = fitter.ReferenceFit(cell.method)
    else:
        method = make_method(cell.method, dict(cell.settings))
        requires, fit = method.requires, fitter.MethodFit(method)
    work = Work(cell, pickle.dumps(fit), requires, deque(), store.stamp(cell.identity))
    todo = list(range(cell.replicates))
    if planned.state is State.FAILED:
        todo = _keep_good(work, store)
    lacking = missing_package(cell.method)
    if lacking:
        work.rows = [Row(i, Status.MISSING_DEPENDENCY, lacking) for i in range(cell.replicates)]
        return work
    size = max(1, min(LARGEST_TASK, cell.replicates // (4 * workers)))
    work.pending.extend(tuple(todo[i : i + size]) for i in range(0, len(todo), size))
    return work


def _keep_good(work: Work, store: Store) -> list[int]:
    """Take over the rows of a stored cell that did not fail; returns the replicates that did."""
    stored = store.load(work.cell.identity)
    retried = FAILURES | {Status.MISSING_DEPENDENCY}
    work.rows = [row for row in stored.rows if row.status not in retried] if stored else []
    work.arrays = store.arrays(stored) if stored else {}
    kept = {row.replicate for row in work.rows}
    return [i for i in range(work.cell.replicates) if i not in kept]


class Board:
    """What is to be done, shared by the slots: each call is one step under a lock."""

    def __init__(self, works: Sequence[Work], store: Store) -> None:
        self.store, self.claims = store, Claims(store.claims)
        self.events: queue.Queue[Any] = queue.Queue()
        self.batches = sum(max(1, len(work.pending)) for work in works)
        self._works = deque(works)
        self._open: list[Work] = []
        self._lock = threading.Lock()
        self._stopped = threading.Event()
        self.complete: queue.Queue[Work] = queue.Queue()

    @property
    def more(self) -> bool:
        """Whether there are cells that nobody has begun."""
        return bool(self._works)

    @property
    def stopped(self) -> bool:
        return self._stopped.is_set()

    def stop(self) -> None:
        self._stopped.set()

    def take(self, last: Work | None) -> tuple[Work, tuple[int, ...]] | None:
        """The next replicates, of the same cell if it has any; None at the end.

        A cell of one slot is shared with others only when no cell is left that nobody works on.
        """
        while not self._stopped.is_set():
            with self._lock:
                if last is not None and last.pending:
                    return self._hand_out(last)
                work = self._claimed() or max(self._open, key=lambda one: len(one.pending), default=None)
                if work is not None and work.pending:
                    return self._hand_out(work)
                if not self._works:
                    return None
            self._stopped.wait(WAIT_S)  # for cells that another run has claimed
        return None

    def _claimed(self) -> Work | None:
        """The next cell that nobody works on; one that another run has stored meanwhile is done."""
        for _ in range(len(self._works)):
            work = self._works.popleft()
            if not self.claims.take(work.cell.identity):
                self._works.append(work)
                continue
            if self._stored_meanwhile(work):
                self.claims.release(work.cell.identity)
                self.events.put((work.cell, work.cell.replicates - len(work.rows)))
                continue
            work.started = time.time()
            self._open.append(work)
            if not work.pending:  # nothing to fit: its package is missing
                self.complete.put(work)
                continue
            return work
        return None

    def _stored_meanwhile(self, work: Work) -> bool:
        cell = work.cell
        if self.store.stamp(cell.identity) == work.stamp:
            return False
        stored = self.store.load(cell.identity)
        return stored is not None and stored.version.get("digest") == cell.version.digest

    def _hand_out(self, work: Work) -> tuple[Work, tuple[int, ...]]:
        return work, work.pending.popleft()

    def split(self, work: Work, replicates: Sequence[int]) -> None:
        """Have replicates tried again one by one."""
        with self._lock:
            work.pending.extendleft((replicate,) for replicate in reversed(replicates))

    def add(self, work: Work, scored: Sequence[Scored]) -> None:
        """Note rows; a cell that is complete goes to be stored."""
        with self._lock:
            for one in scored:
                work.rows.append(one.row)
                work.arrays.update(one.arrays)
                if one.row.replicate == 0:
                    work.facts.update(one.facts)
                if one.traceback:
                    work.tracebacks[one.row.replicate] = one.traceback
            self.events.put((work.cell, len(scored)))
            if work.complete:
                self.complete.put(work)

    def stored(self, work: Work) -> None:
        """Note that a cell is in the store."""
        with self._lock:
            self._open.remove(work)
            self.claims.release(work.cell.identity)
