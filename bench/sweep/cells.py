"""The cells of a run: replicates are fitted and scored in a worker's processes, complete cells stored by a writer.

A scoring process knows the truth, a method's process does not; the driver passes bytes between them unread. A process
that dies loses the replicates that it was given, and they are tried again one by one.
"""

from __future__ import annotations

import contextlib
import pickle
import time
from collections import deque
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from bench.contract.estimate import Status
from bench.engine.pool import Done, Limits, Queued, RunThread, Worker
from bench.engine.progress import Kind
from bench.entrants.reference import REFERENCES
from bench.entrants.registry import make_method, missing_package
from bench.errors import InputError
from bench.isolation.failure import without_places
from bench.isolation.processes import Died
from bench.scoring.row import Row
from bench.store.cell import Cell
from bench.store.provenance import provenance
from bench.store.store import Store
from bench.sweep import method_process, scoring_process
from bench.sweep.method_process import Fit, reference_fit
from bench.sweep.plan import FAILURES, Planned, State
from bench.sweep.scoring_process import Failure, Scored

FIRST_TASK, LARGEST_TASK = 5, 50
"""Largest numbers of replicates that are fitted in one step, first and later, where a method does not state its own."""
TASK_S = 0.5
"""Seconds of fitting in one step, where a replicate takes less."""
SCORING_S = 120.0
"""Limit of the harness's own work on one replicate, and on storing a cell."""
WRITE_ATTEMPTS = 5
SCORING_ATTEMPTS = 3
METHOD, SPARE = "method", "spare"
"""A worker's process for the cell's method, and one that starts for the next cell while this one is scored."""

OnRows = Callable[[Cell, Sequence[Row]], None]
"""Called with a cell and its rows, in order, when all that are wanted are there."""


class ScoringError(Exception):
    """The scoring process raised: a bug of the harness, or of a system."""

    def __init__(self, message: str, log: str) -> None:
        super().__init__(f"{message}\n{log}")
        self.message, self.log = message, log


def ask(thread: RunThread, request: str, *arguments: Any, limit_s: float) -> Any:
    """Return an answer of a thread's scoring process; raises Died where it ended or hung, ScoringError."""
    thread.request(scoring_process.serve, pickle.dumps((request, *arguments)))
    return _scoring_answer(thread, limit_s)


def _scoring_answer(thread: RunThread, limit_s: float) -> Any:
    good, answer = pickle.loads(thread.answer(scoring_process.serve, limit_s))
    if not good:
        raise ScoringError(*answer)
    return answer


@dataclass(eq=False)
class QueuedCell(Queued):
    """A cell to be computed: the replicates that are still to be fitted, and the rows so far.

    Attributes:
        cell: What is computed.
        store: Where it is stored.
        limits: Of a fit, and the number of workers that may share the replicates.
        fit: A pickled ``Fit`` of :mod:`bench.sweep.method_process`.
        requires: Packages that the method needs.
        n_wanted: Number of rows at which the cell is complete.
        stamp: Time at which its file was written as the plan saw it (ns); 0 where there was none.
        size: Number of replicates that the method solves together; 1: as many as take ``TASK_S``.
        on_rows: Called with the complete rows, in place of storing them.
        pending: Replicates to be fitted.
        alone: Replicates to be fitted one by one.
        facts: What tables say of the data that all replicates share.
        bounded: Whether the store keeps a bound of it; without one nothing is fitted.
    """

    cell: Cell
    store: Store
    limits: Limits
    fit: bytes
    requires: tuple[str, ...]
    n_wanted: int
    stamp: int
    size: int = 1
    on_rows: OnRows | None = None
    pending: deque[int] = field(default_factory=deque)
    alone: deque[int] = field(default_factory=deque)
    rows: list[Row] = field(default_factory=list)
    tracebacks: dict[int, str] = field(default_factory=dict)
    arrays: dict[str, np.ndarray] = field(default_factory=dict)
    facts: dict[str, Any] = field(default_factory=dict)
    bounded: bool = True
    started: float = 0.0

    @property
    def key(self) -> str:  # type: ignore[override]
        return self.cell.identity

    @property
    def kind(self) -> Kind:  # type: ignore[override]
        return self.cell.label, self.cell.scenario.label

    @property
    def name(self) -> str:  # type: ignore[override]
        return f"{self.cell.label} {self.cell.scenario.snr_db:g} dB"

    @property
    def together(self) -> int:  # type: ignore[override]
        return min(self.size, self.n_wanted)

    @property
    def complete(self) -> bool:
        return len(self.rows) == self.n_wanted

    @property
    def open(self) -> int:
        return len(self.alone) + len(self.pending)

    def stored(self) -> bool:
        if self.store.stamp(self.key) == self.stamp:
            return False
        stored = self.store.head(self.key)
        return stored is not None and self.cell.version.is_that_of(stored.version)

    def prepare(self) -> None:
        return

    def take(self) -> tuple[int, ...]:
        if self.alone:
            return (self.alone.popleft(),)
        n = min(self._step(), len(self.pending))
        return tuple(self.pending.popleft() for _ in range(n))

    def _step(self) -> int:
        """Return how many replicates to fit in one step: all workers are to have some to the end."""
        if self.size > 1:
            return self.size
        workers = self.limits.workers
        known = [row.wall_s for row in self.rows if np.isfinite(row.wall_s)]
        if not known:
            return max(1, min(FIRST_TASK, self.n_wanted // (4 * workers)))
        share = -(-len(self.pending) // (2 * workers))
        return max(1, min(LARGEST_TASK, share, int(TASK_S / max(float(np.mean(known)), 1e-6))))

    def put_back(self, parts: Sequence[int]) -> None:
        self.alone.extend(parts)

    def add(self, outcome: Sequence[Scored], seconds: float, first: bool) -> Done:
        for scored in outcome:
            self.rows.append(scored.row)
            self.arrays.update(scored.arrays)
            if scored.row.replicate == 0:
                self.facts.update(scored.facts)
            if scored.traceback:
                self.tracebacks[scored.row.replicate] = scored.traceback
        rows = [scored.row for scored in outcome]
        fitting = min(float(np.nansum([row.wall_s for row in rows])), seconds) if first else seconds
        failed = sum(row.status in FAILURES for row in rows)
        return Done(self, len(rows), fitting, seconds - fitting, failed)

    def perform(self, parts: tuple[int, ...], worker: Worker) -> list[Scored] | None:
        """Fit and score replicates; None where they are to be tried again one by one."""
        n, started = len(parts), time.monotonic()
        for attempt in range(SCORING_ATTEMPTS):
            try:
                answers = self._answers(parts, worker)
                if isinstance(answers, Failure):
                    failure = answers
                    break
                worker.request(scoring_process.serve, pickle.dumps(("score", self.cell, answers)))
                if not self.open and worker.tasks.more and SPARE not in worker.processes:
                    worker.processes[SPARE] = worker.children.start(method_process.serve)
                return _scoring_answer(worker, SCORING_S * n)  # type: ignore[no-any-return]
            except (Died, ScoringError) as error:  # of the scoring process, which is no fault of the method
                worker.go_on()
                failure = Failure(Status.INVALID, f"its data or its scores failed: {error.message}", error.log)
                if isinstance(error, ScoringError) or attempt + 1 == SCORING_ATTEMPTS:
                    break
        return None if n > 1 else self._failed(parts[0], failure, time.monotonic() - started, worker)

    def _failed(self, replicate: int, failure: Failure, wall_s: float, worker: Worker) -> list[Scored]:
        try:
            return ask(worker, "fail", self.cell, replicate, failure, wall_s, limit_s=SCORING_S)  # type: ignore[no-any-return]
        except (Died, ScoringError):
            worker.go_on()
            return [Scored(Row(replicate, failure.status, failure.message, wall_s=wall_s), failure.log)]

    def _answers(self, parts: tuple[int, ...], worker: Worker) -> bytes | Failure:
        """Return the packed answers of the method, or why there are none."""
        n, limits = len(parts), self.limits
        task = ask(worker, "open", self.cell, self.fit, parts, limits.timeout_s, limit_s=SCORING_S * n)
        reports: deque[bytes] = deque(maxlen=1)
        try:
            if METHOD not in worker.processes:
                spare = worker.processes.pop(SPARE, None)
                ready = method_process.ready(worker.children, spare, self.requires, limits.memory_mb)
                worker.processes[METHOD] = ready
            method = worker.processes[METHOD]
            return method_process.answers(method, task, n, limits.timeout_s, limits.memory_mb, reports.append)
        except Died as died:
            worker.go_on()
            worker.processes.pop(METHOD, None)
            best = reports[-1] if reports and n == 1 else None
            return Failure(Status(died.reason), died.message, died.log, best)

    def leave(self, worker: Worker) -> None:
        worker.retire(METHOD)

    def finish(self, thread: RunThread | None) -> None:
        """Store the cell, or hand its rows over; raises InputError where it cannot be stored."""
        if self.on_rows is not None:
            self.on_rows(self.cell, sorted(self.rows, key=lambda row: row.replicate))
            return
        assert thread is not None
        try:
            problem = self._store(thread)
        except ScoringError as error:
            self.refuse(f"it cannot be summarised: {error.message}", error.log)
            problem = self._store(thread)
        if problem:
            remedy = f"cannot be written ({problem}); what is stored stays, make room and run the same command again"
            raise InputError("store", self.store.path(self.key), remedy)

    def _store(self, thread: RunThread) -> str:
        """Have the cell stored; returns why it could not be written, or an empty string. Raises ScoringError."""
        version, limits = self.cell.version, self.limits
        come = provenance(version, limits.workers, limits.timeout_s, limits.memory_mb, self.started)
        kept = (self.rows, self.arrays, self.facts, self.errors(), self.bounded, version.as_json(), come)
        problem = ""
        for _ in range(WRITE_ATTEMPTS):
            try:
                return ask(thread, "finish", self.cell, self.store, *kept, limit_s=SCORING_S)  # type: ignore[no-any-return]
            except Died as died:
                thread.go_on()
                if self.stored():  # it died after the work, before its answer
                    return ""
                problem = died.message
        return problem

    def refuse(self, message: str, log: str = "") -> None:
        """Replace all that is known of the cell by the reason why it cannot be scored."""
        self.rows = [replace(row, status=Status.INVALID, message=message, scores={}) for row in self.rows]
        self.arrays, self.facts, self.tracebacks = {}, {}, {self.rows[0].replicate: log}
        self.bounded = False  # that may have been the reason

    def errors(self) -> str:
        """Return the tracebacks of all failed replicates, in order."""
        parts = [f"replicate {i}\n{text.rstrip()}\n" for i, text in sorted(self.tracebacks.items()) if text.strip()]
        return without_places("\n".join(parts))


def queue_cell(
    planned: Planned,
    store: Store,
    limits: Limits,
    replicates: Collection[int] | None = None,
    unbounded: str = "",
    on_rows: OnRows | None = None,
) -> QueuedCell:
    """Return a planned cell with what is to be fitted.

    Args:
        planned: The cell; where it is tried again, the rows that did not fail are taken over.
        store: Where it is, or will be.
        limits: Of the run.
        replicates: The numbers of those that are wanted; None: all.
        unbounded: Why it has no bound, if it has none.
        on_rows: Called with the complete rows, in place of storing them.
    """
    cell = planned.cell
    wanted = sorted(range(cell.replicates) if replicates is None else replicates)
    fit, requires, size = _fit(cell)
    packed = pickle.dumps(fit)
    queued = QueuedCell(cell, store, limits, packed, requires, len(wanted), planned.stamp, size, on_rows)
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
    """Return what is run, the packages that it needs, and how many problems it solves together."""
    if cell.method in REFERENCES:
        return partial(reference_fit, cell.method), (), 1
    method = make_method(cell.method, dict(cell.settings))
    return method.identify_many, method.requires, method.problems_at_once


def _keep_good(queued: QueuedCell, store: Store) -> None:
    """Take over the rows of a stored cell that did not fail; none where it or its arrays are damaged."""
    with contextlib.suppress(InputError):
        stored = store.load(queued.key)
        if stored is not None:
            queued.arrays = dict(stored.arrays)
            retried = FAILURES | {Status.MISSING_DEPENDENCY}
            queued.rows = [row for row in stored.rows if row.status not in retried]
