"""The threads of a run: workers, each with a scoring process and the process of one method, and writers.

A scoring process knows the truth, a method's process does not; the worker passes bytes between them, ends what hangs,
dies or grows too large, and records it. A writer has complete cells summarised and stored, while the workers go on.
"""

from __future__ import annotations

import pickle
import queue
import threading
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

from bench.contract.estimate import Status
from bench.errors import InputError
from bench.isolation.processes import READY_S, Child, Children, Died
from bench.scoring.row import Row
from bench.store.provenance import provenance
from bench.sweep import method_process, scoring_process
from bench.sweep.queue import CellQueue, QueuedCell
from bench.sweep.scoring_process import Failure, Scored

SCORING_S = 120.0
"""Limit of the harness's own work on one replicate, and on storing a cell."""
WRITE_ATTEMPTS = 5
SCORING_ATTEMPTS = 3
LOOK_S = 0.05


@dataclass(frozen=True)
class Limits:
    """``timeout_s`` and ``memory_mb`` hold for one replicate's fit; ``preload`` names packages imported once."""

    workers: int = 1
    timeout_s: float = 600.0
    memory_mb: float = 4096.0
    preload: tuple[str, ...] = ()


class Stopped(Exception):
    """The run is over: what its own end did to a process is nobody's failure."""


class ScoringError(Exception):
    """The scoring process raised: a bug of the harness, or of a system."""

    def __init__(self, message: str, log: str) -> None:
        super().__init__(f"{message}\n{log}")
        self.message, self.log = message, log


class RunThread(threading.Thread, ABC):
    """A thread of the run with a scoring process of its own; what it raises goes to the queue's events."""

    def __init__(self, cells: CellQueue, children: Children, limits: Limits) -> None:
        super().__init__(daemon=True)
        self.cells, self.children, self.limits = cells, children, limits
        self.scoring: Child | None = None

    @abstractmethod
    def work(self) -> None:
        """Until there is nothing more to do."""

    def run(self) -> None:
        try:
            self.work()
        except Stopped:
            pass
        except BaseException as error:
            self.cells.events.put(error)

    def ask(self, request: str, *arguments: Any, limit_s: float) -> Any:
        """An answer of the scoring process; raises Died where it ended or hung, ScoringError where it raised."""
        self.request(request, *arguments)
        return self.answer(limit_s)

    def request(self, request: str, *arguments: Any) -> None:
        """Ask without waiting."""
        if self.scoring is None:
            self.scoring = self.children.start(scoring_process.serve)
            self.scoring.receive(READY_S)
        self.scoring.send(pickle.dumps((request, *arguments)))

    def answer(self, limit_s: float) -> Any:
        """What the scoring process says to the last request."""
        assert self.scoring is not None
        try:
            good, answer = pickle.loads(self.scoring.receive(limit_s))
        except Died:
            self.scoring = None
            raise
        if not good:
            raise ScoringError(*answer)
        return answer

    def go_on(self) -> None:
        """Raise Stopped where the run is over."""
        if self.cells.stopped:
            raise Stopped


class Worker(RunThread):
    """Fits: one method's process at a time, a fresh one for every cell."""

    def __init__(self, cells: CellQueue, children: Children, limits: Limits) -> None:
        super().__init__(cells, children, limits)
        self.method: Child | None = None
        self.spare: Child | None = None  # for the next cell: it starts while this one is scored

    def work(self) -> None:
        queued: QueuedCell | None = None
        try:
            while (taken := self.cells.take(queued)) is not None:
                first, started = taken[0] is not queued, time.monotonic()
                if first:
                    self._retire_method()
                queued, replicates = taken
                scored = self._done(queued, replicates)
                if scored is None:
                    self.cells.split(queued, replicates)
                else:
                    self.cells.add(queued, scored, time.monotonic() - started, first)
        finally:
            self._retire_method()

    def _done(self, queued: QueuedCell, replicates: tuple[int, ...]) -> list[Scored] | None:
        """The rows of some replicates; None where they are to be tried again one by one."""
        n, started = len(replicates), time.monotonic()
        for attempt in range(SCORING_ATTEMPTS):
            try:
                answers = self._answers(queued, replicates)
                if isinstance(answers, bytes):
                    self.request("score", queued.cell, answers)
                    if not queued.open and self.cells.more and self.spare is None:
                        self.spare = self.children.start(method_process.serve)
                    return self.answer(SCORING_S * n)  # type: ignore[no-any-return]
                failure = answers
                break
            except (
                Died,
                ScoringError,
            ) as error:  # of the scoring process, which is no fault of the method
                self.go_on()
                failure = Failure(Status.INVALID, f"its data or its scores failed: {error.message}", error.log)
                if isinstance(error, ScoringError) or attempt + 1 == SCORING_ATTEMPTS:
                    break
        return None if n > 1 else self._failed(queued, replicates[0], failure, time.monotonic() - started)

    def _failed(self, queued: QueuedCell, replicate: int, failure: Failure, wall_s: float) -> list[Scored]:
        try:
            return self.ask("fail", queued.cell, replicate, failure, wall_s, limit_s=SCORING_S)  # type: ignore[no-any-return]
        except (Died, ScoringError):
            self.go_on()
            return [Scored(Row(replicate, failure.status, failure.message, wall_s=wall_s), failure.log)]

    def _answers(self, queued: QueuedCell, replicates: tuple[int, ...]) -> bytes | Failure:
        """The packed answers of a method, or why there are none."""
        n, limits = len(replicates), self.limits
        task: bytes = self.ask("open", queued.cell, queued.fit, replicates, limits.timeout_s, limit_s=SCORING_S * n)
        reports: list[bytes] = []

        def keep(report: bytes) -> None:
            reports[:] = [report]

        try:
            if self.method is None:
                spare, self.spare = self.spare, None
                self.method = method_process.ready(self.children, spare, queued.requires, limits.memory_mb)
            return method_process.answers(self.method, task, n, limits.timeout_s, limits.memory_mb, keep)
        except Died as died:
            self.go_on()
            self.method = None
            best = reports[-1] if reports and n == 1 else None
            return Failure(Status(died.reason), died.message, died.log, best)

    def _retire_method(self) -> None:
        if self.method is not None:
            self.method.retire()
            self.method = None


class Writer(RunThread):
    """Has complete cells summarised and stored."""

    def __init__(self, cells: CellQueue, children: Children, limits: Limits, workers: list[Worker]) -> None:
        super().__init__(cells, children, limits)
        self.workers = workers

    def work(self) -> None:
        for cell in self.cells.wanted:  # read off the source once a method: now, while the first fits start
            _ = cell.version
        while not self.cells.stopped:
            over = not any(one.is_alive() for one in self.workers)  # before the look: what is complete then is all
            try:
                queued = self.cells.complete.get(timeout=LOOK_S)
            except queue.Empty:
                if over:
                    return
                continue
            self._store(queued)

    def _store(self, queued: QueuedCell) -> None:
        limits, version = self.limits, queued.cell.version
        come = provenance(version, limits.workers, limits.timeout_s, limits.memory_mb, queued.started)
        try:
            problem = self._finish(queued, version.as_json(), come)
        except ScoringError as error:
            queued.refuse(f"it cannot be summarised: {error.message}", error.log)
            problem = self._finish(queued, version.as_json(), come)
        if problem:
            remedy = f"cannot be written ({problem}); what is stored stays, make room and run the same command again"
            raise InputError("store", self.cells.store.path(queued.cell.identity), remedy)
        self.cells.close(queued)

    def _finish(self, queued: QueuedCell, version: Any, come: Any) -> str:
        """Have a cell stored; returns why it could not be written, or nothing. Raises ScoringError."""
        kept = (queued.rows, queued.arrays, queued.facts, queued.errors(), queued.bounded)
        problem = ""
        for _ in range(WRITE_ATTEMPTS):
            try:
                return self.ask(  # type: ignore[no-any-return]
                    "finish", queued.cell, self.cells.store, *kept, version, come, limit_s=SCORING_S
                )
            except Died as died:
                self.go_on()
                if self.cells.stored_meanwhile(queued):  # it died with the answer, not before the work
                    return ""
                problem = died.message
        return problem
