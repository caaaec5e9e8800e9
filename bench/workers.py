"""Processes that fit: each gets problems and never a truth, one thread, a time limit that ends in a kill.

A worker that dies, hangs or raises costs only the replicates it held: those are tried once more alone, and the one
that fails again is recorded with its status.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import resource
import signal
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any

import numpy as np

from bench.estimate import Estimate, Status

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")


def single_threaded() -> None:
    """Fix numerical libraries loaded from now on to one thread: workers are processes, and share the cores."""
    for variable in THREAD_VARIABLES:
        os.environ[variable] = "1"


Fit = Callable[[Sequence[Any], Sequence[np.random.Generator]], list[Estimate]]
"""What a worker runs: payloads and random streams to estimates. A method's ``identify_many``, or a reference row's."""


@dataclass(frozen=True, eq=False)
class Task:
    """Replicates to be fitted together: their numbers, what the fit is given, and their random streams."""

    key: Any
    replicates: tuple[int, ...]
    fit: Fit
    payloads: tuple[Any, ...]
    rngs: tuple[np.random.Generator, ...]
    timeout_s: float

    def split(self) -> list[Task]:
        """One task a replicate."""
        parts = zip(self.replicates, self.payloads, self.rngs, strict=True)
        return [Task(self.key, (r,), self.fit, (p,), (g,), self.timeout_s) for r, p, g in parts]

    @property
    def limit(self) -> float:
        return self.timeout_s * len(self.replicates)


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of one replicate: an estimate (maybe a failed one), and what the fit took."""

    replicate: int
    estimate: Estimate | None
    status: Status
    message: str
    wall_s: float = float("nan")
    cpu_s: float = float("nan")
    peak_memory_mb: float = float("nan")


def _peak_memory_mb() -> float:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 2**20 if sys.platform == "darwin" else peak / 2**10


def _perform(task: Task) -> list[Outcome]:
    """Fit, timed; an exception becomes a ``crashed`` outcome of every replicate of the task."""
    wall, cpu = time.perf_counter(), time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            estimates = task.fit(task.payloads, task.rngs)
        if len(estimates) != len(task.replicates) or not all(isinstance(e, Estimate) for e in estimates):
            raise TypeError(f"{len(task.replicates)} Estimate objects were expected")
        checked = [estimate.checked() for estimate in estimates]
    except MemoryError:
        return [Outcome(r, None, Status.OOM, "out of memory") for r in task.replicates]
    except Exception as error:
        message = " ".join(f"{type(error).__name__}: {error}".split())[:300]
        return [Outcome(r, None, Status.CRASHED, message) for r in task.replicates]
    n = len(task.replicates)
    wall, cpu = (time.perf_counter() - wall) / n, (time.process_time() - cpu) / n
    memory = _peak_memory_mb()
    return [
        Outcome(r, e, e.status, e.message, wall, cpu, memory) for r, e in zip(task.replicates, checked, strict=True)
    ]


def _work(connection: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.dup2(2, 1)  # whatever a library prints must not mix with the results on stdout
    while True:
        try:
            task: Task = connection.recv()
        except (EOFError, OSError):
            return
        outcomes = _perform(task)
        try:
            connection.send(outcomes)
        except OSError:
            return  # nobody waits for it any more
        except Exception as error:
            message = f"the estimate cannot be pickled: {error}"[:300]
            connection.send([Outcome(r, None, Status.INVALID, message) for r in task.replicates])


class _Worker:
    def __init__(self, context: Any) -> None:
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=_work, args=(theirs,), daemon=True)
        self.process.start()
        theirs.close()
        self.task: Task | None = None
        self.deadline = float("inf")

    def give(self, task: Task) -> None:
        self.task, self.deadline = task, time.monotonic() + task.limit
        with contextlib.suppress(OSError):  # a worker that died idle is seen as a death at the next look
            self.connection.send(task)

    def kill(self) -> None:
        self.process.kill()
        self.process.join()
        self.connection.close()


def perform(tasks: Sequence[Task], workers: int, preload: Sequence[str] = ()) -> Iterator[tuple[Task, list[Outcome]]]:
    """Do the tasks in ``workers`` processes; yields each with its outcomes as it ends, in any order.

    ``preload`` names modules that the server process imports once, so that a new worker starts in milliseconds.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["bench.workers", *preload])
    queue = list(reversed(tasks))
    pool: list[_Worker] = []
    try:
        while queue or any(worker.task for worker in pool):
            while queue and len(pool) < workers:
                pool.append(_Worker(context))
            for worker in pool:
                if worker.task is None and queue:
                    worker.give(queue.pop())
            busy = [worker for worker in pool if worker.task]
            nearest = min(worker.deadline for worker in busy) - time.monotonic()
            ready = wait([worker.connection for worker in busy], timeout=max(0.0, min(nearest, 1.0)))
            for worker in busy:
                if worker.connection in ready or time.monotonic() > worker.deadline:
                    yield from _collect(worker, worker.connection in ready, pool, queue)
    finally:
        for worker in pool:
            worker.kill()


def _collect(
    worker: _Worker, ready: bool, pool: list[_Worker], queue: list[Task]
) -> Iterator[tuple[Task, list[Outcome]]]:
    task = worker.task
    assert task is not None
    outcomes: list[Outcome] | None = None
    if ready:
        try:
            outcomes = worker.connection.recv()
        except (EOFError, OSError):
            worker.process.join(5)
            failure = _death(worker.process.exitcode)
        except Exception as error:
            message = " ".join(f"the estimate cannot be unpickled: {type(error).__name__}: {error}".split())[:300]
            outcomes = [Outcome(r, None, Status.INVALID, message) for r in task.replicates]
    else:
        failure = Status.TIMEOUT, f"stopped after the limit of {task.timeout_s:g} s"
    if outcomes is None:
        worker.kill()
        pool.remove(worker)
        if len(task.replicates) > 1:
            queue.extend(task.split())
            return
        outcomes = [Outcome(task.replicates[0], None, *failure)]
    elif len(task.replicates) > 1 and all(o.estimate is None for o in outcomes):
        worker.task = None
        queue.extend(task.split())
        return
    worker.task = None
    yield task, outcomes


def _death(exitcode: int | None) -> tuple[Status, str]:
    if exitcode is not None and exitcode < 0:
        return Status.KILLED, f"its process was ended by {signal.Signals(-exitcode).name}"
    return Status.CRASHED, f"its process exited with status {exitcode}"
