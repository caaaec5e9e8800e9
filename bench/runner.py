"""A run: every cell that is wanted becomes a stored row, whatever its method does.

Each slot pairs a judge, which knows the truth, with the process of one method, which does not, and passes bytes between
them. A slot ends what hangs, dies or grows too large, and records it; a cell is stored the moment it is complete.
"""

from __future__ import annotations

import pickle
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any

import numpy as np

from bench import fitter, judge
from bench.bound import load_bounds
from bench.cell import Cell
from bench.claims import Claims
from bench.errors import InputError
from bench.estimate import Status
from bench.judge import Failure, Scored
from bench.plan import FAILURES, Planned, State
from bench.processes import READY_S, Child, Children, Died
from bench.provenance import provenance
from bench.reference import REFERENCES
from bench.registry import load_method, make_method, missing_package
from bench.row import Row
from bench.store import Store

LARGEST_TASK = 5
"""Replicates that a method gets at once, at most: what is lost, and tried again one by one, when a process dies."""
SCORING_S = 120.0
"""Limit of the harness's own work on one replicate."""
WRITE_ATTEMPTS = 5
JUDGE_ATTEMPTS = 3
WAIT_S = 0.5

Progress = Callable[[Cell, int], None]


@dataclass(frozen=True)
class Limits:
    """``timeout_s`` and ``memory_mb`` hold for one replicate's fit; ``preload`` names packages imported once."""

    workers: int = 1
    timeout_s: float = 600.0
    memory_mb: float = 4096.0
    preload: tuple[str, ...] = ()


@dataclass
class _Work:
    """A cell under way."""

    cell: Cell
    fit: bytes
    requires: tuple[str, ...]
    pending: deque[tuple[int, ...]]
    stamp: int
    rows: list[Row] = field(default_factory=list)
    tracebacks: dict[int, str] = field(default_factory=dict)
    arrays: dict[str, np.ndarray] = field(default_factory=dict)
    started: float = 0.0
    under_way: int = 0
    taken: bool = False

    @property
    def complete(self) -> bool:
        return len(self.rows) == self.cell.replicates

    def errors(self) -> str:
        """The tracebacks of all failed replicates, in order."""
        parts = [f"replicate {i}\n{text.rstrip()}\n" for i, text in sorted(self.tracebacks.items()) if text.strip()]
        return "\n".join(parts)


def run_cells(planned: Sequence[Planned], store: Store, limits: Limits, on_progress: Progress | None = None) -> None:
    """Compute and store the cells of a plan that are to be run.

    ``on_progress(cell, n)`` is called when ``n`` more replicates of a cell are done. Raises InputError where the store
    can no longer be written; all that was stored stays.
    """
    wanted = [one for one in planned if one.run]
    if not wanted:
        return
    load_bounds([(one.cell.scenario, one.cell.seed) for one in wanted], store.bounds)
    board = Board([_work(one, store, limits.workers) for one in wanted], store)
    children = Children([name for name in limits.preload if _needed(name, wanted)])
    slots = [Slot(board, children, limits) for _ in range(max(1, min(limits.workers, board.batches)))]
    try:
        for slot in slots:
            slot.start()
        while any(slot.is_alive() for slot in slots) or not board.events.empty():
            try:
                event = board.events.get(timeout=0.2)
            except queue.Empty:
                continue
            if isinstance(event, BaseException):
                raise event
            if on_progress is not None:
                on_progress(*event)
    finally:
        board.stop()
        children.close()
        board.claims.release_all()


def _needed(package: str, wanted: Sequence[Planned]) -> bool:
    methods = {one.cell.method for one in wanted} - set(REFERENCES)
    return any(package in load_method(name).requires for name in methods) and find_spec(package) is not None


def _work(planned: Planned, store: Store, workers: int) -> _Work:
    """The replicates to be fitted: all of them, or those that failed where a cell is tried again."""
    cell = planned.cell
    requires: tuple[str, ...] = ()
    if cell.method in REFERENCES:
        fit: Any = fitter.ReferenceFit(cell.method)
    else:
        method = make_method(cell.method, dict(cell.settings))
        requires, fit = method.requires, fitter.MethodFit(method)
    work = _Work(cell, pickle.dumps(fit), requires, deque(), _stamp(store, cell))
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


def _keep_good(work: _Work, store: Store) -> list[int]:
    """Take over the rows of a stored cell that did not fail; returns the replicates that did."""
    stored = store.load(work.cell.identity)
    retried = FAILURES | {Status.MISSING_DEPENDENCY}
    work.rows = [row for row in stored.rows if row.status not in retried] if stored else []
    work.arrays = store.arrays(stored) if stored else {}
    kept = {row.replicate for row in work.rows}
    return [i for i in range(work.cell.replicates) if i not in kept]


class Board:
    """What is to be done, shared by the slots: each call is one step under a lock."""

    def __init__(self, works: Sequence[_Work], store: Store) -> None:
        self.store, self.claims = store, Claims(store.claims)
        self.events: queue.Queue[Any] = queue.Queue()
        self.batches = sum(max(1, len(work.pending)) for work in works)
        self._works = deque(works)
        self._open: list[_Work] = []
        self._lock = threading.Lock()
        self._stopped = threading.Event()

    @property
    def stopped(self) -> bool:
        return self._stopped.is_set()

    def stop(self) -> None:
        self._stopped.set()

    def take(self, last: _Work | None) -> tuple[_Work, tuple[int, ...]] | None:
        """The next replicates, of the same cell if it has any; none of them where only storing is left; None at the
        end. A cell of one slot is shared with others only when no cell is left that nobody works on."""
        while not self._stopped.is_set():
            with self._lock:
                if last is not None and last.pending:
                    return self._hand_out(last)
                work = self._claimed() or max(self._open, key=lambda one: len(one.pending), default=None)
                if work is not None and (work.pending or (work.complete and not work.taken)):
                    return self._hand_out(work)
                if not self._works:
                    return None
            self._stopped.wait(WAIT_S)  # for cells that another run has claimed
        return None

    def _claimed(self) -> _Work | None:
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
            return work
        return None

    def _stored_meanwhile(self, work: _Work) -> bool:
        cell = work.cell
        if _stamp(self.store, cell) == work.stamp:
            return False
        stored = self.store.load(cell.identity)
        return stored is not None and stored.version.get("digest") == cell.version.digest

    def _hand_out(self, work: _Work) -> tuple[_Work, tuple[int, ...]]:
        if not work.pending:
            work.taken = True
            return work, ()
        work.under_way += 1
        return work, work.pending.popleft()

    def split(self, work: _Work, replicates: Sequence[int]) -> None:
        """Have replicates tried again one by one."""
        with self._lock:
            work.under_way -= 1
            work.pending.extendleft((replicate,) for replicate in reversed(replicates))

    def add(self, work: _Work, scored: Sequence[Scored]) -> bool:
        """Note rows; True where the cell is complete, and is then this slot's to store."""
        with self._lock:
            work.under_way -= 1
            for one in scored:
                work.rows.append(one.row)
                work.arrays.update(one.arrays)
                if one.traceback:
                    work.tracebacks[one.row.replicate] = one.traceback
            self.events.put((work.cell, len(scored)))
            complete = work.complete and not work.taken
            work.taken = work.taken or complete
            return complete

    def stored(self, work: _Work) -> None:
        with self._lock:
            self._open.remove(work)
            self.claims.release(work.cell.identity)


def _stamp(store: Store, cell: Cell) -> int:
    """When the stored cell was written; 0 where there is none."""
    try:
        return store.path(cell.identity).stat().st_mtime_ns
    except OSError:
        return 0


class _Stopped(Exception):
    """The run is over: what its own end did to a process is nobody's failure."""


class _JudgeError(Exception):
    """The judge raised: a bug of the harness, or of a system."""

    def __init__(self, message: str, log: str) -> None:
        super().__init__(f"{message}\n{log}")
        self.message, self.log = message, log


class Slot(threading.Thread):
    """One judge and one method's process at a time; a fresh one for every cell."""

    def __init__(self, board: Board, children: Children, limits: Limits) -> None:
        super().__init__(daemon=True)
        self.board, self.children, self.limits = board, children, limits
        self.judge: Child | None = None
        self.fitter: Child | None = None

    def run(self) -> None:
        work: _Work | None = None
        try:
            while (taken := self.board.take(work)) is not None:
                if taken[0] is not work:
                    self._retire_fitter()
                work, replicates = taken
                scored = self._done(work, replicates) if replicates else None
                if not replicates or (scored is not None and self.board.add(work, scored)):
                    self._store(work)
        except _Stopped:
            pass
        except BaseException as error:
            self.board.events.put(error)
        finally:
            self._retire_fitter()

    def _done(self, work: _Work, replicates: tuple[int, ...]) -> list[Scored] | None:
        """The rows of some replicates; None where they are to be tried again one by one."""
        n, started = len(replicates), time.monotonic()
        for attempt in range(JUDGE_ATTEMPTS):
            try:
                answers = self._answers(work, replicates)
                if isinstance(answers, bytes):
                    return self._ask("score", work.cell, answers, limit_s=SCORING_S * n)  # type: ignore[no-any-return]
                failure = answers
                break
            except (Died, _JudgeError) as error:  # of the judge; that somebody ended it is not the method's doing
                self._go_on()
                failure = Failure(Status.INVALID, f"its data or its scores failed: {error.message}", error.log)
                if isinstance(error, _JudgeError) or attempt + 1 == JUDGE_ATTEMPTS:
                    break
        if n > 1:
            self.board.split(work, replicates)
            return None
        failure = _at(failure, time.monotonic() - started)
        try:
            return self._ask("fail", work.cell, replicates[0], failure, limit_s=SCORING_S)  # type: ignore[no-any-return]
        except (Died, _JudgeError):
            self._go_on()
            return [Scored(Row(replicates[0], failure.status, failure.message), failure.log)]

    def _answers(self, work: _Work, replicates: tuple[int, ...]) -> bytes | Failure:
        """The packed answers of a method, or why there are none."""
        n = len(replicates)
        task: bytes = self._ask("open", work.cell, work.fit, replicates, self.limits.timeout_s, limit_s=SCORING_S * n)
        memory = self.limits.memory_mb
        best: bytes | None = None
        deadline = 0.0
        try:
            if self.fitter is None:
                self.fitter = self.children.start(fitter.serve, work.requires, memory)
                self.fitter.receive(READY_S)
            self.fitter.send(task)
            limit = self.limits.timeout_s * n
            deadline = time.monotonic() + limit
            while True:
                message = self.fitter.receive(max(0.0, deadline - time.monotonic()), memory)
                if message[:1] == b"d":
                    return message[1:]
                best = message[1:]
        except Died as died:
            self._go_on()
            self.fitter = None
            message_text = died.message
            if died.reason == "timeout":
                message_text = f"stopped after the limit of {self.limits.timeout_s:g} s"
            return Failure(Status(died.reason), message_text, died.log, best=best if n == 1 else None)

    def _ask(self, request: str, *arguments: Any, limit_s: float) -> Any:
        if self.judge is None:
            self.judge = self.children.start(judge.serve)
            self.judge.receive(READY_S)
        self.judge.send(pickle.dumps((request, *arguments)))
        try:
            good, answer = pickle.loads(self.judge.receive(limit_s))
        except Died:
            self.judge = None
            raise
        if not good:
            raise _JudgeError(*answer)
        return answer

    def _store(self, work: _Work) -> None:
        limits = self.limits
        version = work.cell.version
        come = provenance(version, limits.workers, limits.timeout_s, limits.memory_mb, work.started)
        arguments = (work.cell, self.board.store, work.rows, work.arrays, work.errors(), version.as_json(), come)
        problem = ""
        for _ in range(WRITE_ATTEMPTS):
            try:
                problem = self._ask("finish", *arguments, limit_s=SCORING_S)
                break
            except Died as died:
                self._go_on()
                problem = died.message
        if problem:
            remedy = f"cannot be written ({problem}); what is stored stays, make room and run the same command again"
            raise InputError("store", self.board.store.path(work.cell.identity), remedy)
        self.board.stored(work)

    def _go_on(self) -> None:
        if self.board.stopped:
            raise _Stopped

    def _retire_fitter(self) -> None:
        if self.fitter is not None:
            self.fitter.retire()
            self.fitter = None


def _at(failure: Failure, wall_s: float) -> Failure:
    return Failure(failure.status, failure.message, failure.log, wall_s, failure.best)
