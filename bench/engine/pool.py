"""The worker pool: tasks are claimed, executed within limits of time and memory, and counted.

Each worker is a thread of the driver with its own child processes, which it ends when they exceed their limits. A task
with a stored result is not repeated; a task claimed by another driver is waited for.
"""

from __future__ import annotations

import json
import logging
import math
import multiprocessing
import pickle
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from bench.engine.progress import Kind, OnProgress, Progress, first_of_each_kind_first
from bench.errors import InputError
from bench.isolation.failure import one_line
from bench.isolation.processes import READY_S, Child, Children, Died
from bench.store.locks import Claims

WAIT_S = 0.5
"""Interval of checks on tasks claimed by another driver (s)."""
PATIENCE_S = 3.0
"""Waiting time for another driver after which a line is printed (s)."""


@dataclass(frozen=True)
class Limits:
    """Limits of a run: number of workers, time (s) and memory (MB) of one fit; ``preload``: packages imported once."""

    workers: int = 1
    timeout_s: float = 600.0
    memory_mb: float = 4096.0
    preload: tuple[str, ...] = ()


class StoredTask(Protocol):
    """A task with a stored result, such as a block of the atlas; it is pickled into a process of the pool.

    ``key`` is a digest of everything that the result depends on; tasks of one ``kind`` have similar cost; ``size`` is
    the number of fits; ``limit_s`` is the time limit (s).
    """

    @property
    def key(self) -> str: ...
    @property
    def kind(self) -> Kind: ...
    @property
    def size(self) -> int: ...
    @property
    def limit_s(self) -> float: ...

    def stored(self, folder: Path) -> bool:
        """Return whether a complete result is stored."""

    def compute(self, folder: Path) -> None:
        """Compute and store the result; raises InputError if it cannot be stored."""


class Stopped(Exception):
    """The run was stopped; processes that ended with it have not failed."""


class Counted(NamedTuple):
    """Number of finished parts, number of failed ones, and the reason if the task has no result."""

    n: int
    failed: int = 0
    error: str = ""


class DividedTask:
    """A task divided into parts, which workers take one after another.

    The parts of a cell are its replicates (:class:`bench.engine.cells.CellJob`); a :class:`StoredTask` has one part.
    """

    def __init__(self, key: str, kind: Kind, name: str, size: int) -> None:
        self.key, self.kind, self.name, self.size = key, kind, name, size
        self.done = 0
        """Number of finished fits, of ``size``."""
        self.pending: deque[Any] = deque()
        self.started = 0.0
        """Time of the claim (seconds since the epoch)."""

    def stored(self) -> bool:
        """Return whether another driver has stored the result since the plan was made."""
        raise NotImplementedError

    def take(self) -> Any:
        """Remove and return the next pending parts."""
        return self.pending.popleft()

    def put_back(self, parts: Any) -> None:
        """Return parts that are to be repeated."""
        self.pending.append(parts)

    def perform(self, parts: Any, worker: Worker) -> Any:
        """Execute parts in the processes of a worker; returns None if they are to be repeated."""
        raise NotImplementedError

    def add(self, outcome: Any) -> Counted:
        """Add an outcome of :meth:`perform`."""
        raise NotImplementedError

    def finish(self, worker: Worker) -> None:
        """Store the result after the last part; raises InputError if it cannot be stored."""


class TaskJob(DividedTask):
    """A :class:`StoredTask`, executed and stored by one call in a child process."""

    def __init__(self, task: StoredTask, folder: Path, memory_mb: float) -> None:
        super().__init__(task.key, task.kind, " ".join(task.kind), task.size)
        self.task, self.folder, self.memory_mb = task, folder, memory_mb
        self.pending.append(task)

    def stored(self) -> bool:
        return self.task.stored(self.folder)

    def perform(self, parts: StoredTask, worker: Worker) -> str:
        try:
            child = worker.process(serve_tasks)
            child.send(pickle.dumps((parts, self.folder)))
            answer = json.loads(child.receive(parts.limit_s, self.memory_mb))
        except Died as died:
            worker.lose(serve_tasks)
            return died.message
        if "input_error" in answer:
            raise InputError(*map(str, answer["input_error"]))
        return str(answer["error"])

    def add(self, outcome: str) -> Counted:
        self.done = self.size
        return Counted(self.size, self.size if outcome else 0, outcome)


def serve_tasks(connection: Connection) -> None:
    """Execute tasks in a process of the pool until the connection is closed."""
    multiprocessing.current_process().daemon = False  # the fit of a measured record starts child processes
    connection.send_bytes(b"ready")
    while True:
        answer: dict[str, Any] = {"error": ""}
        task, folder = pickle.loads(connection.recv_bytes())
        try:
            task.compute(folder)
        except InputError as error:
            answer = {"input_error": [error.field, str(error.value), error.remedy]}
        except Exception as error:
            answer = {"error": one_line(error)}
        connection.send_bytes(json.dumps(answer).encode())  # never pickle: code of a method has run in this process


class TaskQueue:
    """The tasks of a run, shared by its threads; every method is atomic."""

    def __init__(self, jobs: Sequence[DividedTask], claims: Path) -> None:
        self.claims = Claims(claims)
        self.events: queue.Queue[Any] = queue.Queue()
        """Events for the driver: finished parts, lines to print, errors, and workers that have ended."""
        self.stopped = threading.Event()
        self._waiting = deque(jobs)
        self._open: list[DividedTask] = []
        self._changed = threading.Condition()
        self._waited_since: float | None = None

    @property
    def more(self) -> bool:
        """True if there are tasks that no worker has begun."""
        return bool(self._waiting)

    def take(self, last: DividedTask | None) -> tuple[DividedTask, Any] | None:
        """Return the next task and its parts (None if all are done); None at the end of the run.

        A worker continues its last task. The parts of a task are shared among workers only when no other task is left.
        """
        with self._changed:
            while not self.stopped.is_set():
                if last is not None and last.pending:
                    return last, last.take()
                if job := self._claimed():
                    return job, job.take() if job.pending else None
                busiest = max(self._open, key=lambda job: len(job.pending), default=None)
                if busiest is not None and busiest.pending:
                    return busiest, busiest.take()
                if not self._waiting:
                    return None
                if not self._open:
                    self._report_waiting()
                self._changed.wait(WAIT_S)  # another driver may release or store a task
        return None

    def _report_waiting(self) -> None:
        """Print once, after a delay, that all remaining tasks are claimed by other drivers."""
        now = time.monotonic()
        if self._waited_since is None:
            self._waited_since = now
        elif now - self._waited_since > PATIENCE_S:
            self._waited_since = math.inf
            holder = self.claims.holder(self._waiting[0].key)
            self.events.put(f"waiting for another run on this store ({len(self._waiting)} cells left): {holder}")

    def _claimed(self) -> DividedTask | None:
        """Claim the next free task; tasks that another driver has stored meanwhile are counted as done."""
        for _ in range(len(self._waiting)):
            job = self._waiting.popleft()
            if not self.claims.take(job.key):
                self._waiting.append(job)
            elif job.stored():
                self.claims.release(job.key)
                self.events.put((job, Counted(job.size - job.done), math.nan))
            else:
                job.started = time.time()
                self._open.append(job)
                return job
        return None

    def put_back(self, job: DividedTask, parts: Any) -> None:
        """Return parts of a task that are to be repeated."""
        with self._changed:
            job.put_back(parts)
            self._changed.notify_all()

    def add(self, job: DividedTask, outcome: Any, seconds: float) -> bool:
        """Add an outcome that took ``seconds``; returns whether the task is complete."""
        with self._changed:
            self.events.put((job, job.add(outcome), seconds))
            return job.done == job.size

    def close(self, job: DividedTask) -> None:
        """Release the claim of a finished task."""
        with self._changed:
            self._open.remove(job)
            self.claims.release(job.key)


class Worker(threading.Thread):
    """A thread of the driver that executes tasks in its own child processes; errors become events."""

    def __init__(self, tasks: TaskQueue, children: Children) -> None:
        super().__init__(daemon=True)
        self.tasks, self.children = tasks, children
        self.processes: dict[Hashable, Child] = {}
        self.serving: DividedTask | None = None
        """The cell for which the process of a method was started."""

    def run(self) -> None:
        """Execute tasks until none is left; an exception becomes an event."""
        job: DividedTask | None = None
        try:
            while (taken := self.tasks.take(job)) is not None:
                job, parts = taken
                self._perform(job, parts)
            for role in tuple(self.processes):
                self.retire(role)
        except Stopped:
            pass
        except BaseException as error:
            self.tasks.events.put(error)
        finally:
            self.tasks.events.put(self)

    def _perform(self, job: DividedTask, parts: Any) -> None:
        complete = parts is None
        if not complete:
            started = time.monotonic()
            outcome = job.perform(parts, self)
            if outcome is None:
                self.tasks.put_back(job, parts)
                return
            complete = self.tasks.add(job, outcome, time.monotonic() - started)
        if complete:
            job.finish(self)
            self.tasks.close(job)

    def process(self, serve: Callable[[Connection], None]) -> Child:
        """Return the process that runs ``serve``, started if there is none; raises Died."""
        if serve not in self.processes:
            self.processes[serve] = self.children.start(serve)
            self.processes[serve].receive(READY_S)
        return self.processes[serve]

    def lose(self, role: Hashable) -> None:
        """Remove a process that has died; raises Stopped if the run has been stopped."""
        self.processes.pop(role, None)
        if self.tasks.stopped.is_set():
            raise Stopped

    def retire(self, role: Hashable) -> None:
        """End a process, if there is one, by closing its connection."""
        if child := self.processes.pop(role, None):
            child.retire()


def run_jobs(
    jobs: Sequence[DividedTask],
    claims: Path,
    children: Children,
    workers: int,
    counted: tuple[str, str],
    on_progress: OnProgress | None = None,
) -> dict[str, str]:
    """Execute tasks with a pool of workers.

    Args:
        jobs: The tasks.
        claims: Folder of the claims.
        children: Child processes of the run; they are ended if an exception is raised.
        workers: Largest number of workers.
        counted: Names of a part and of a task in the progress display; an empty name means that tasks are not counted.
        on_progress: Called with each new state.

    Returns:
        The reason, by the key of each task without a result.

    Raises:
        InputError: A result cannot be stored; stored results are kept.
    """
    n_workers = min(workers, sum(max(1, len(job.pending)) for job in jobs))
    jobs = first_of_each_kind_first(jobs, lambda job: job.kind)
    tasks = TaskQueue(jobs, claims)
    tasks.claims.prepare()
    sizes, kinds = {job.key: job.size - job.done for job in jobs}, {job.key: job.kind for job in jobs}
    progress = Progress(counted[0], sizes, kinds, n_workers, counted[1])
    show = on_progress or (lambda look: None)
    running = {Worker(tasks, children) for _ in range(n_workers)}
    errors: dict[str, str] = {}
    try:
        show(progress.state())
        for worker in tuple(running):
            worker.start()
        while running:
            event = tasks.events.get()
            if isinstance(event, BaseException):
                raise event
            if isinstance(event, Worker):
                running.remove(event)
            elif isinstance(event, str):
                print_line(event)
            else:
                job, done, seconds = event
                if done.error:
                    errors[job.key] = done.error
                show(progress.add(job.key, done.n, seconds, done.failed, job.name))
    except BaseException:
        tasks.stopped.set()
        children.close()
        raise
    finally:
        tasks.stopped.set()
        tasks.claims.release_all()
    return errors


def print_line(line: str) -> None:
    """Log a warning, which the command line prints above a progress bar if there is one."""
    logging.getLogger("bench").warning(line)


def run_tasks(
    tasks: Sequence[StoredTask],
    folder: Path,
    limits: Limits,
    counted: tuple[str, str],
    on_progress: OnProgress | None = None,
) -> dict[str, str]:
    """Compute and store the tasks whose results are not in ``folder`` yet; see :func:`run_jobs`.

    Each task has its own time limit.
    """
    jobs = [TaskJob(task, folder, limits.memory_mb) for task in tasks if not task.stored(folder)]
    if not jobs:
        return {}
    with Children(limits.preload) as children:
        return run_jobs(jobs, folder / "claims", children, limits.workers, counted, on_progress)
