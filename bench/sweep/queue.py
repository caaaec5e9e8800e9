"""What a run has to do, and how far it is: cells, the replicates of each that are still to be fitted, their rows."""

from __future__ import annotations

import contextlib
import math
import pickle
import queue
import threading
import time
from collections import deque
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from bench.contract.estimate import Status
from bench.entrants.reference import REFERENCES
from bench.entrants.registry import make_method, missing_package
from bench.errors import InputError
from bench.isolation.failure import without_places
from bench.scoring.row import Row
from bench.store.cell import Cell
from bench.store.locks import Claims
from bench.store.store import Store
from bench.sweep.method_process import Fit, MethodFit, ReferenceFit
from bench.sweep.plan import FAILURES, Planned, State
from bench.sweep.progress import Fitted
from bench.sweep.scoring_process import Scored

FIRST_TASK, LARGEST_TASK = 5, 50
"""Replicates in a task, at most, where a method does not say how many it solves together: of the first, and of those
after it. A process that dies loses all of its task, and they are tried again one by one."""
TASK_S = 0.5
"""Seconds of fitting in a task, where its replicates take so little that there are several in it."""
WAIT_S = 0.5
PATIENCE_S = 3.0
"""How long a run waits for another before it says so."""


@dataclass(frozen=True)
class Waiting:
    """So many cells are left, all claimed by other runs, one of them by ``holder``."""

    cells: int
    holder: str

    def __str__(self) -> str:
        return f"waiting for another run on this store (cells left: {self.cells}): {self.holder}"


@dataclass
class QueuedCell:
    """A cell to be computed: the replicates that are still to be fitted, and the rows so far.

    Attributes:
        cell: What is computed.
        fit: A pickled :class:`bench.sweep.method_process.Fit`.
        requires: Packages that the method needs.
        n_wanted: Rows at which the cell is complete.
        stamp: When its file was written as the plan saw it (ns); 0 where there was none.
        size: How many replicates the method solves together; 1: as many as take ``TASK_S``.
        workers: How many workers may share them.
        pending: Replicates to be fitted.
        alone: Replicates to be fitted by themselves.
        facts: What tables say of the data that all replicates share.
        bounded: Whether the store keeps a bound of it; without one nothing is fitted.
        started: Seconds since the epoch.
    """

    cell: Cell
    fit: bytes
    requires: tuple[str, ...]
    n_wanted: int
    stamp: int
    size: int = 1
    workers: int = 1
    pending: deque[int] = field(default_factory=deque)
    alone: deque[int] = field(default_factory=deque)
    rows: list[Row] = field(default_factory=list)
    tracebacks: dict[int, str] = field(default_factory=dict)
    arrays: dict[str, np.ndarray] = field(default_factory=dict)
    facts: dict[str, Any] = field(default_factory=dict)
    bounded: bool = True
    started: float = 0.0

    @property
    def complete(self) -> bool:
        return len(self.rows) == self.n_wanted

    @property
    def open(self) -> int:
        """How many replicates nobody has begun."""
        return len(self.alone) + len(self.pending)

    def next_task(self) -> tuple[int, ...]:
        """The replicates to be fitted next, at least one where any is open."""
        if self.alone:
            return (self.alone.popleft(),)
        n = min(self._task_size(), len(self.pending))
        return tuple(self.pending.popleft() for _ in range(n))

    def _task_size(self) -> int:
        """As the method says; else as many as take ``TASK_S``, and such that all workers have some to the end."""
        if self.size > 1:
            return self.size
        known = [row.wall_s for row in self.rows if np.isfinite(row.wall_s)]
        if not known:
            return max(1, min(FIRST_TASK, self.n_wanted // (4 * self.workers)))
        each = float(np.mean(known))
        share = -(-len(self.pending) // (2 * self.workers))
        return max(1, min(LARGEST_TASK, share, int(TASK_S / max(each, 1e-6))))

    def refuse(self, message: str, log: str = "") -> None:
        """Have every replicate say why the cell cannot be told, in the place of whatever was known of it."""
        self.rows = [replace(row, status=Status.INVALID, message=message, scores={}) for row in self.rows]
        self.arrays, self.facts, self.tracebacks = {}, {}, {self.rows[0].replicate: log}
        self.bounded = False  # that may have been the reason

    def errors(self) -> str:
        """The tracebacks of all failed replicates, in order."""
        parts = [f"replicate {i}\n{text.rstrip()}\n" for i, text in sorted(self.tracebacks.items()) if text.strip()]
        return without_places("\n".join(parts))


def queue_cell(
    planned: Planned, store: Store, workers: int, replicates: Collection[int] | None = None, unbounded: str = ""
) -> QueuedCell:
    """A planned cell, with what is to be fitted.

    Args:
        planned: The cell; where it is tried again, the rows that did not fail are taken over.
        store: Where it is, or will be.
        workers: How many share the replicates.
        replicates: The numbers of those that are wanted; None: all.
        unbounded: Why it has no bound, if it has none.
    """
    cell = planned.cell
    wanted = sorted(range(cell.replicates) if replicates is None else replicates)
    fit, requires, size = _fit(cell)
    queued = QueuedCell(cell, pickle.dumps(fit), requires, len(wanted), planned.stamp, size, workers)
    if unbounded:
        queued.rows = [Row(i, Status.INVALID, unbounded) for i in wanted]
        queued.bounded = False
        return queued
    lacking = missing_package(cell.method)
    if lacking:
        queued.rows = [Row(i, Status.MISSING_DEPENDENCY, lacking) for i in wanted]
        return queued
    if planned.state is State.FAILED:
        _keep_good(queued, store)
    kept = {row.replicate for row in queued.rows}
    queued.pending.extend(i for i in wanted if i not in kept)
    return queued


def _fit(cell: Cell) -> tuple[Fit, tuple[str, ...], int]:
    """What is run, the packages that it needs, and how many problems it solves together."""
    if cell.method in REFERENCES:
        return ReferenceFit(cell.method), (), 1
    method = make_method(cell.method, dict(cell.settings))
    return MethodFit(method), method.requires, method.problems_at_once


def _keep_good(queued: QueuedCell, store: Store) -> None:
    """Take over the rows of a stored cell that did not fail; none where it or its arrays are damaged."""
    with contextlib.suppress(InputError):
        stored = store.load(queued.cell.identity)
        if stored is not None:
            queued.arrays = store.arrays(stored)
            retried = FAILURES | {Status.MISSING_DEPENDENCY}
            queued.rows = [row for row in stored.rows if row.status not in retried]


class CellQueue:
    """The cells of a run, shared by its threads: each call is one step under a lock.

    No cell is begun while ``most_complete`` wait to be stored, be the store ever so slow: each holds a claim.
    """

    def __init__(self, cells: Sequence[QueuedCell], store: Store, most_complete: int = 4) -> None:
        self.store, self.claims = store, Claims(store.claims)
        self.events: queue.Queue[Any] = queue.Queue()
        self.n_replicates = sum(max(1, queued.open) for queued in cells)
        self.wanted = tuple(queued.cell for queued in cells)
        self.methods = {cell.method for cell in self.wanted}
        self.complete: queue.Queue[QueuedCell] = queue.Queue()
        self.most_complete = most_complete
        self._waiting = deque(cells)
        self._open: list[QueuedCell] = []
        self._changed = threading.Condition()
        self._stopped = threading.Event()
        self._waited_since: float | None = None

    @property
    def more(self) -> bool:
        """Whether there are cells that nobody has begun."""
        return bool(self._waiting)

    @property
    def stopped(self) -> bool:
        return self._stopped.is_set()

    def stop(self) -> None:
        self._stopped.set()
        with self._changed:
            self._changed.notify_all()

    def take(self, last: QueuedCell | None) -> tuple[QueuedCell, tuple[int, ...]] | None:
        """The next task, of the same cell if it has any; None at the end.

        A cell of one worker is shared with others only when no cell is left that nobody works on.
        """
        with self._changed:
            while not self._stopped.is_set():
                if last is not None and last.open:
                    return last, last.next_task()
                room = sum(queued.complete for queued in self._open) < self.most_complete
                queued = (self._claimed() if room else None) or max(self._open, key=lambda one: one.open, default=None)
                if queued is not None and queued.open:
                    return queued, queued.next_task()
                if not self._waiting:
                    return None
                if not self._open:
                    self._tell_of_waiting()
                self._changed.wait(WAIT_S)  # for room, or for cells that another run has claimed
        return None

    def _tell_of_waiting(self) -> None:
        """Say once, after a while, that all that is left is claimed by other runs, and by whom."""
        now = time.monotonic()
        if self._waited_since is None:
            self._waited_since = now
        elif now - self._waited_since > PATIENCE_S:
            self._waited_since = math.inf
            holder = self.claims.holder(self._waiting[0].cell.identity)
            self.events.put(Waiting(len(self._waiting), holder))

    def _claimed(self) -> QueuedCell | None:
        """The next cell that nobody works on; one that another run has stored meanwhile is done."""
        for _ in range(len(self._waiting)):
            queued = self._waiting.popleft()
            if not self.claims.take(queued.cell.identity):
                self._waiting.append(queued)
                continue
            if self.stored_meanwhile(queued):
                self.claims.release(queued.cell.identity)
                self.events.put(Fitted(queued.cell, queued.open))
                continue
            queued.started = time.time()
            self._open.append(queued)
            if not queued.open:  # nothing to fit: its package or its bound is missing
                self.events.put(Fitted(queued.cell, 0, queued.rows))
                self.complete.put(queued)
                continue
            return queued
        return None

    def stored_meanwhile(self, queued: QueuedCell) -> bool:
        """Whether a cell of this version has come into the store since the plan."""
        cell = queued.cell
        if self.store.stamp(cell.identity) == queued.stamp:
            return False
        stored = self.store.load(cell.identity)
        return stored is not None and stored.version.get("digest") == cell.version.digest

    def split(self, queued: QueuedCell, replicates: Sequence[int]) -> None:
        """Have replicates tried again one by one."""
        with self._changed:
            queued.alone.extend(replicates)

    def add(self, queued: QueuedCell, scored: Sequence[Scored], seconds: float = math.nan, first: bool = False) -> None:
        """Note rows, and what they took a worker, who may have begun the cell with them.

        A cell that is complete goes to be stored.
        """
        with self._changed:
            for one in scored:
                queued.rows.append(one.row)
                queued.arrays.update(one.arrays)
                if one.row.replicate == 0:
                    queued.facts.update(one.facts)
                if one.traceback:
                    queued.tracebacks[one.row.replicate] = one.traceback
            self.events.put(Fitted(queued.cell, len(scored), [one.row for one in scored], seconds, first))
            if queued.complete:
                self.complete.put(queued)

    def close(self, queued: QueuedCell) -> None:
        """Note that a complete cell has been dealt with."""
        with self._changed:
            self._open.remove(queued)
            self.claims.release(queued.cell.identity)
            self._changed.notify_all()
