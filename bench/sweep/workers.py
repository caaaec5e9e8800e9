"""Who does the work of a run: slots, each with a judge and the process of one method, and writers.

A judge knows the truth, a method's process does not; the slot passes bytes between them, ends what hangs, dies or grows
too large, and records it. A writer summarises and stores complete cells, while the slots go on.
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
from bench.sweep import method_process as fitter
from bench.sweep import scoring_process as judge
from bench.sweep.queue import Board, Work
from bench.sweep.scoring_process import Failure, Scored

SCORING_S = 120.0
"""Limit of the harness's own work on one replicate, and on storing a cell."""
WRITE_ATTEMPTS = 5
JUDGE_ATTEMPTS = 3
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


class JudgeError(Exception):
    """The judge raised: a bug of the harness, or of a system."""

    def __init__(self, message: str, log: str) -> None:
        super().__init__(f"{message}\n{log}")
        self.message, self.log = message, log


class Hand(threading.Thread, ABC):
    """A thread of the run with a judge of its own; what it raises goes to the board."""

    def __init__(self, board: Board, children: Children, limits: Limits) -> None:
        super().__init__(daemon=True)
        self.board, self.children, self.limits = board, children, limits
        self.judge: Child | None = None

    @abstractmethod
    def work(self) -> None:
        """Until there is nothing more to do."""

    def run(self) -> None:
        try:
            self.work()
        except Stopped:
            pass
        except BaseException as error:
            self.board.events.put(error)

    def ask(self, request: str, *arguments: Any, limit_s: float) -> Any:
        """An answer of the judge; raises Died where it ended or hung, JudgeError where it raised."""
        self.request(request, *arguments)
        return self.answer(limit_s)

    def request(self, request: str, *arguments: Any) -> None:
        """Ask without waiting."""
        if self.judge is None:
            self.judge = self.children.start(judge.serve)
            self.judge.receive(READY_S)
        self.judge.send(pickle.dumps((request, *arguments)))

    def answer(self, limit_s: float) -> Any:
        """What the judge says to the last request."""
        assert self.judge is not None
        try:
            good, answer = pickle.loads(self.judge.receive(limit_s))
        except Died:
            self.judge = None
            raise
        if not good:
            raise JudgeError(*answer)
        return answer

    def go_on(self) -> None:
        """Raise Stopped where the run is over."""
        if self.board.stopped:
            raise Stopped


class Slot(Hand):
    """Fits: one method's process at a time, a fresh one for every cell."""

    def __init__(self, board: Board, children: Children, limits: Limits) -> None:
        super().__init__(board, children, limits)
        self.fitter: Child | None = None
        self.spare: Child | None = None

    def work(self) -> None:
        work: Work | None = None
        try:
            while (taken := self.board.take(work)) is not None:
                if taken[0] is not work:
                    self._retire_fitter()
                work, replicates = taken
                scored = self._done(work, replicates)
                if scored is None:
                    self.board.split(work, replicates)
                else:
                    self.board.add(work, scored)
        finally:
            self._retire_fitter()

    def _done(self, work: Work, replicates: tuple[int, ...]) -> list[Scored] | None:
        """The rows of some replicates; None where they are to be tried again one by one."""
        n, started = len(replicates), time.monotonic()
        for attempt in range(JUDGE_ATTEMPTS):
            try:
                answers = self._answers(work, replicates)
                if isinstance(answers, bytes):
                    self.request("score", work.cell, answers)
                    if not work.pending and self.board.more and self.spare is None:
                        self.spare = self.children.start(fitter.serve)  # for the next cell, while this one is scored
                    return self.answer(SCORING_S * n)  # type: ignore[no-any-return]
                failure = answers
                break
            except (Died, JudgeError) as error:  # of the judge; that somebody ended it is not the method's doing
                self.go_on()
                failure = Failure(Status.INVALID, f"its data or its scores failed: {error.message}", error.log)
                if isinstance(error, JudgeError) or attempt + 1 == JUDGE_ATTEMPTS:
                    break
        return None if n > 1 else self._failed(work, replicates[0], failure, time.monotonic() - started)

    def _failed(self, work: Work, replicate: int, failure: Failure, wall_s: float) -> list[Scored]:
        try:
            return self.ask("fail", work.cell, replicate, failure, wall_s, limit_s=SCORING_S)  # type: ignore[no-any-return]
        except (Died, JudgeError):
            self.go_on()
            return [Scored(Row(replicate, failure.status, failure.message, wall_s=wall_s), failure.log)]

    def _answers(self, work: Work, replicates: tuple[int, ...]) -> bytes | Failure:
        """The packed answers of a method, or why there are none."""
        n, limits = len(replicates), self.limits
        task: bytes = self.ask("open", work.cell, work.fit, replicates, limits.timeout_s, limit_s=SCORING_S * n)
        reports: list[bytes] = []
        try:
            if self.fitter is None:
                spare, self.spare = self.spare, None
                self.fitter = fitter.ready(self.children, spare, work.requires, limits.memory_mb)
            return fitter.answers(self.fitter, task, n, limits.timeout_s, limits.memory_mb, reports.append)
        except Died as died:
            self.go_on()
            self.fitter = None
            best = reports[-1] if reports and n == 1 else None
            return Failure(Status(died.reason), died.message, died.log, best)

    def _retire_fitter(self) -> None:
        if self.fitter is not None:
            self.fitter.retire()
            self.fitter = None


class Writer(Hand):
    """Has complete cells summarised and stored."""

    def __init__(self, board: Board, children: Children, limits: Limits, slots: list[Slot]) -> None:
        super().__init__(board, children, limits)
        self.slots = slots

    def work(self) -> None:
        while not self.board.stopped:
            over = not any(slot.is_alive() for slot in self.slots)  # before the look: what is complete then is all
            try:
                work = self.board.complete.get(timeout=LOOK_S)
            except queue.Empty:
                if over:
                    return
                continue
            self._store(work)

    def _store(self, work: Work) -> None:
        limits, version = self.limits, work.cell.version
        come = provenance(version, limits.workers, limits.timeout_s, limits.memory_mb, work.started)
        kept = (work.rows, work.arrays, work.facts, work.errors())
        problem = ""
        for _ in range(WRITE_ATTEMPTS):
            try:
                problem = self.ask(
                    "finish", work.cell, self.board.store, *kept, version.as_json(), come, limit_s=SCORING_S
                )
                break
            except Died as died:
                self.go_on()
                problem = died.message
        if problem:
            remedy = f"cannot be written ({problem}); what is stored stays, make room and run the same command again"
            raise InputError("store", self.board.store.path(work.cell.identity), remedy)
        self.board.stored(work)
