"""The cells of a run: replicates are fitted and scored in the processes of a worker, and complete cells are stored.

The scoring process knows the true values, the method's process does not; the driver passes bytes between them without
unpickling them. If a process dies, the replicates that it was working on are repeated one by one.
"""

from __future__ import annotations

import contextlib
import pickle
import time
from collections import deque
from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from bench.contract.estimate import Status
from bench.engine import method_process, scoring_process
from bench.engine.method_process import reference_fit
from bench.engine.plan import FAILURES, CellState, Planned
from bench.engine.pool import Counted, DividedTask, Limits, Worker
from bench.engine.scoring_process import Failure, ScoredRows
from bench.entrants.reference import REFERENCES
from bench.entrants.registry import make_method, missing_package
from bench.errors import InputError
from bench.isolation.processes import Died
from bench.scoring.row import Row, Rows
from bench.store.provenance import provenance
from bench.store.store import Store

FIRST_STEP, LARGEST_STEP = 5, 50
"""Largest numbers of replicates per step, first and later, unless the method sets ``problems_at_once``."""
STEP_S = 0.5
"""Duration of a step (s), if a replicate takes less."""
SCORING_S = 120.0
"""Time limit for simulating and scoring one replicate, and for storing a cell (s)."""
ATTEMPTS = 3
"""Number of attempts if the scoring process is killed from outside."""
METHOD, SPARE = "method", "spare"
"""Roles of a worker's processes: for the method of the cell, and started in advance for the next cell."""


class ScoringError(Exception):
    """The scoring process raised an exception: a bug of the benchmark or of a system."""

    def __init__(self, message: str, log: str) -> None:
        super().__init__(f"{message}\n{log}")
        self.message, self.log = message, log


def ask(worker: Worker, request: str, *arguments: Any, limit_s: float = SCORING_S) -> Any:
    """Call a method of :class:`~bench.engine.scoring_process.Scorer` in a worker's scoring process.

    Raises:
        Died: The process ended or exceeded the limit.
        ScoringError: The method raised an exception.
    """
    message = pickle.dumps((request, *arguments))
    for attempt in range(ATTEMPTS):
        try:
            child = worker.process(scoring_process.serve)
            child.send(message)
            good, answer = pickle.loads(child.receive(limit_s))
            break
        except Died as died:
            worker.lose(scoring_process.serve)
            if died.reason == "timeout" or attempt + 1 == ATTEMPTS:
                raise
    if not good:
        raise ScoringError(*answer)
    return answer


class CellJob(DividedTask):
    """A cell to be computed: the replicates still to be fitted, and the rows so far.

    Args:
        planned: The cell. If failed replicates are repeated, the rows of the others are kept.
        store: The store of the cell.
        limits: Limits of a fit, and the number of workers.
        replicates: Numbers of the replicates to compute without storing them; None for all, which are stored.
        unbounded: Reason why the bound could not be computed; nothing is fitted then.
    """

    def __init__(
        self,
        planned: Planned,
        store: Store,
        limits: Limits,
        replicates: Collection[int] | None = None,
        unbounded: str = "",
    ) -> None:
        cell = planned.cell
        requested = sorted(range(cell.replicates) if replicates is None else replicates)
        name = f"{cell.label} {cell.scenario.snr_db:g} dB"
        super().__init__(cell.identity, (cell.label, cell.scenario.label), name, len(requested))
        self.cell, self.stamp, self.store, self.limits = cell, planned.stamp, store, limits
        self.bounded, self.saves = not unbounded, replicates is None
        self.alone: set[int] = set()
        """Replicates to be fitted one by one."""
        self.scored = ScoredRows()
        self._prepare_fit()
        missing = missing_package(cell.method)
        if unbounded or missing:
            status = Status.INVALID if unbounded else Status.MISSING_DEPENDENCY
            self.scored.rows = Rows.from_rows(Row(i, status, unbounded or missing or "") for i in requested)
        elif planned.state is CellState.FAILED:
            self._keep_successful()
        finished = set(self.scored.rows.plain("replicate"))
        self.done = len(finished)
        self.pending = deque(i for i in requested if i not in finished)

    def _prepare_fit(self) -> None:
        """Set the pickled fit, the packages that it requires, and the number of problems that it solves at once."""
        self.requires: tuple[str, ...] = ()
        self.at_once = 1
        if self.cell.method in REFERENCES:
            self.fit = pickle.dumps(partial(reference_fit, self.cell.method))
            return
        method = make_method(self.cell.method, dict(self.cell.settings))
        self.fit = pickle.dumps(method.identify_many)
        self.requires, self.at_once = method.requires, method.problems_at_once

    def _keep_successful(self) -> None:
        """Keep the rows of the stored cell that did not fail; none if the cell or its arrays are damaged."""
        with contextlib.suppress(InputError):
            stored = self.store.load(self.key)
            if stored is not None:
                self.scored.arrays = dict(stored.arrays)
                good = [s not in FAILURES and s is not Status.MISSING_DEPENDENCY for s in stored.columns.statuses]
                self.scored.rows = stored.columns.take(np.flatnonzero(good))

    def stored(self) -> bool:
        if self.store.stamp(self.key) == self.stamp:
            return False
        stored = self.store.head(self.key)
        return stored is not None and self.cell.version.matches(stored.version)

    def take(self) -> tuple[int, ...]:
        n = 1 if self.pending[0] in self.alone else min(self._step(), len(self.pending))
        return tuple(self.pending.popleft() for _ in range(n))

    def _step(self) -> int:
        """Return the number of replicates of the next step, so that no worker is idle at the end."""
        if self.at_once > 1:
            return self.at_once
        workers = self.limits.workers
        wall_s = self.scored.rows.numbers("wall_s")
        known = wall_s[np.isfinite(wall_s)]
        if not known.size:
            return max(1, min(FIRST_STEP, self.size // (4 * workers)))
        share = -(-len(self.pending) // (2 * workers))
        return max(1, min(LARGEST_STEP, share, int(STEP_S / max(float(np.mean(known)), 1e-6))))

    def put_back(self, parts: Sequence[int]) -> None:
        self.alone.update(parts)
        self.pending.extendleft(reversed(parts))

    def perform(self, parts: tuple[int, ...], worker: Worker) -> ScoredRows | None:
        """Fit and score replicates; returns None if they are to be repeated one by one."""
        started = time.monotonic()
        try:
            answers = self._answers(parts, worker)
            if not self.pending and worker.tasks.more and SPARE not in worker.processes:
                worker.processes[SPARE] = worker.children.start(method_process.serve)
            if isinstance(answers, bytes):
                return ask(worker, "score", self.cell, answers, limit_s=SCORING_S * len(parts))  # type: ignore[no-any-return]
            failure = answers
        except (Died, ScoringError) as error:  # the scoring process failed, not the method
            failure = Failure(Status.INVALID, f"simulation or scoring failed: {error.message}", error.log)
        if failure is None or len(parts) > 1:
            return None
        wall_s = time.monotonic() - started
        try:
            return ask(worker, "fail", self.cell, parts[0], failure, wall_s)  # type: ignore[no-any-return]
        except (Died, ScoringError):
            row = Row(parts[0], failure.status, failure.message, wall_s=wall_s)
            return ScoredRows(Rows.from_rows([row]), {parts[0]: failure.log})

    def _answers(self, parts: tuple[int, ...], worker: Worker) -> bytes | Failure | None:
        """Return the packed answers of the method, or its failure; None if several replicates failed together."""
        n, limits = len(parts), self.limits
        task = ask(worker, "open", self.cell, self.fit, parts, limits.timeout_s, limit_s=SCORING_S * n)
        reports: deque[bytes] = deque(maxlen=1)
        try:
            if worker.serving is not self:
                worker.retire(METHOD)
                worker.serving = self
            if METHOD not in worker.processes:
                spare = worker.processes.pop(SPARE, None)
                ready = method_process.ready(worker.children, spare, self.requires, limits.memory_mb)
                worker.processes[METHOD] = ready
            method = worker.processes[METHOD]
            return method_process.answers(method, task, n, limits.timeout_s, limits.memory_mb, reports.append)
        except Died as died:
            worker.lose(METHOD)
            best = reports[-1] if reports and n == 1 else None
            return Failure(Status(died.reason), died.message, died.log, best)

    def add(self, outcome: ScoredRows) -> Counted:
        self.scored.add(outcome)
        self.done += len(outcome.rows)
        return Counted(len(outcome.rows), sum(status in FAILURES for status in outcome.rows.statuses))

    def finish(self, worker: Worker) -> None:
        """Store the cell; raises InputError if it cannot be written."""
        if not self.saves:
            return
        try:
            problem = self._store(worker)
        except ScoringError as error:
            self.invalidate(f"cannot be summarised: {error.message}", error.log)
            problem = self._store(worker)
        if problem:
            remedy = f"cannot be written ({problem}); free disk space and run the same command again"
            raise InputError("store", self.store.path(self.key), remedy)

    def _store(self, worker: Worker) -> str:
        """Store the cell; returns the reason why it could not be written, or an empty string. Raises ScoringError."""
        limits, version = self.limits, self.cell.version
        origin = provenance(version, limits.workers, limits.timeout_s, limits.memory_mb, self.started)
        content = (self.cell, self.store, self.scored, self.bounded, version.as_json(), origin)
        try:
            return ask(worker, "finish", *content)  # type: ignore[no-any-return]
        except Died as died:
            return died.message

    def invalidate(self, message: str, log: str = "") -> None:
        """Mark all replicates as invalid, with the reason, and drop their scores."""
        rows = [replace(row, status=Status.INVALID, message=message, scores={}) for row in self.scored.rows]
        self.scored = ScoredRows(Rows.from_rows(rows), {rows[0].replicate: log})
        self.bounded = False  # the bound may have been the reason
