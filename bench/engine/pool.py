"""The pool of processes: tasks are claimed, performed within limits of time and memory, and counted.

Each worker is a thread of the driver with processes of its own, which it ends when they hang, die or grow too large. A
task whose result is stored is not performed again, and one that another driver has claimed is waited for.
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

from bench.engine.progress import Kind, OnLook, Progress, firsts_first
from bench.errors import InputError
from bench.isolation.failure import one_line
from bench.isolation.processes import READY_S, Child, Children, Died
from bench.store.locks import Claims

WAIT_S = 0.5
"""Interval at which tasks are looked at that another driver has claimed (s)."""
PATIENCE_S = 3.0
"""Time that a driver waits for another before it prints a line (s)."""


@dataclass(frozen=True)
class Limits:
    """Limits of a run: ``timeout_s`` and ``memory_mb`` of one fit; ``preload``: packages that are imported once."""

    workers: int = 1
    timeout_s: float = 600.0
    memory_mb: float = 4096.0
    preload: tuple[str, ...] = ()


class StoredTask(Protocol):
    """A piece of work with a stored result, e.g. a block of the atlas. It is pickled into a process of the pool.

    ``key`` is a digest of all that the result depends on; tasks of one ``kind`` cost as much; ``size`` is the number of
    fits; ``limit_s`` is the limit of time.
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
        """Return whether the result is stored whole."""

    def compute(self, folder: Path) -> None:
        """Compute and store the result; raises InputError where it cannot be stored."""


class Stopped(Exception):
    """The run is over: a process that ended with it has not failed."""


class Counted(NamedTuple):
    """Parts that are done, how many of them failed, and why there is no result."""

    n: int
    failed: int = 0
    error: str = ""


class DividedTask:
    """A task as the driver sees it: it has parts, which workers take one after another; a :class:`StoredTask` has one.

    A cell has a replicate in each part (:class:`bench.engine.cells.CellJob`).
    """

    def __init__(self, key: str, kind: Kind, name: str, size: int) -> None:
        self.key, self.kind, self.name, self.size = key, kind, name, size
        self.done = 0
        """Fits that are done, of ``size``."""
        self.pending: deque[Any] = deque()
        self.started = 0.0
        """Time at which it was claimed (seconds since the epoch)."""

    def stored(self) -> bool:
        """Return whether another driver has stored the result since the plan."""
        raise NotImplementedError

    def take(self) -> Any:
        """Take the next of the pending parts."""
        return self.pending.popleft()

    def put_back(self, parts: Any) -> None:
        """Return parts that are to be tried again."""
        self.pending.append(parts)

    def perform(self, parts: Any, worker: Worker) -> Any:
        """Perform parts in the processes of a worker; None where they are to be tried again."""
        raise NotImplementedError

    def add(self, outcome: Any) -> Counted:
        """Keep the outcome of :meth:`perform`."""
        raise NotImplementedError

    def finish(self, worker: Worker) -> None:
        """Store the result, once all parts are done; raises InputError where that cannot be."""


class TaskJob(DividedTask):
    """A :class:`StoredTask`, which one call in one process performs and stores."""

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
        if "refused" in answer:
            raise InputError(*map(str, answer["refused"]))
        return str(answer["error"])

    def add(self, outcome: str) -> Counted:
        self.done = self.size
        return Counted(self.size, self.size if outcome else 0, outcome)


def serve_tasks(connection: Connection) -> None:
    """Perform tasks in a process of the pool, until the connection is closed."""
    multiprocessing.current_process().daemon = False  # a measured fit starts processes of its own
    connection.send_bytes(b"ready")
    while True:
        answer: dict[str, Any] = {"error": ""}
        task, folder = pickle.loads(connection.recv_bytes())
        try:
            task.compute(folder)
        except InputError as error:
            answer = {"refused": [error.field, str(error.value), error.remedy]}
        except Exception as error:
            answer = {"error": one_line(error)}
        connection.send_bytes(json.dumps(answer).encode())  # a method has run here: its driver rebuilds no pickle of it


class TaskQueue:
    """The tasks of a run, shared by its threads: each call is one step under a lock."""

    def __init__(self, jobs: Sequence[DividedTask], claims: Path) -> None:
        self.claims = Claims(claims)
        self.events: queue.Queue[Any] = queue.Queue()
        """For the driver: what was done, lines to be printed, errors, and workers that have ended."""
        self.stopped = threading.Event()
        self._waiting = deque(jobs)
        self._open: list[DividedTask] = []
        self._changed = threading.Condition()
        self._waited_since: float | None = None

    @property
    def more(self) -> bool:
        """Return whether there are tasks that no worker has begun."""
        return bool(self._waiting)

    def take(self, last: DividedTask | None) -> tuple[DividedTask, Any] | None:
        """Return a task and the parts to be performed next, of the last task if it has any; None at the end.

        There are no parts where all are done.
        The parts of a task are shared among workers only when no task is left that no worker has begun.
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
                self._changed.wait(WAIT_S)  # for tasks that another driver has claimed
        return None

    def _report_waiting(self) -> None:
        """Print once, after a while, that all that is left is claimed by other drivers."""
        now = time.monotonic()
        if self._waited_since is None:
            self._waited_since = now
        elif now - self._waited_since > PATIENCE_S:
            self._waited_since = math.inf
            holder = self.claims.holder(self._waiting[0].key)
            self.events.put(f"waiting for another run on this store (cells left: {len(self._waiting)}): {holder}")

    def _claimed(self) -> DividedTask | None:
        """Claim the next task that no driver works on; one that another has stored meanwhile is done."""
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
        """Return parts of a task that are to be tried again."""
        with self._changed:
            job.put_back(parts)
            self._changed.notify_all()

    def add(self, job: DividedTask, outcome: Any, seconds: float) -> bool:
        """Keep an outcome, which took a worker ``seconds``; return whether the task is complete."""
        with self._changed:
            self.events.put((job, job.add(outcome), seconds))
            return job.done == job.size

    def close(self, job: DividedTask) -> None:
        """Give up the claim of a task that is finished."""
        with self._changed:
            self._open.remove(job)
            self.claims.release(job.key)


class Worker(threading.Thread):
    """A thread of the driver that performs tasks in processes of its own; errors become events."""

    def __init__(self, tasks: TaskQueue, children: Children) -> None:
        super().__init__(daemon=True)
        self.tasks, self.children = tasks, children
        self.processes: dict[Hashable, Child] = {}
        self.serving: DividedTask | None = None
        """The cell that the process of a method is for."""

    def run(self) -> None:
        """Perform tasks until there are none, and report what is raised."""
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
        """Return the process that serves a function; it is started where there is none. Raises Died."""
        if serve not in self.processes:
            self.processes[serve] = self.children.start(serve)
            self.processes[serve].receive(READY_S)
        return self.processes[serve]

    def lose(self, role: Hashable) -> None:
        """Forget a process that has died; raises Stopped where it ended with the run."""
        self.processes.pop(role, None)
        if self.tasks.stopped.is_set():
            raise Stopped

    def retire(self, role: Hashable) -> None:
        """Let a process end, if there is one."""
        if child := self.processes.pop(role, None):
            child.retire()


def run_jobs(
    jobs: Sequence[DividedTask],
    claims: Path,
    children: Children,
    workers: int,
    counted: tuple[str, str],
    on_look: OnLook | None = None,
) -> dict[str, str]:
    """Perform tasks.

    Args:
        jobs: The tasks.
        claims: Folder of the claims.
        children: The processes of the run; they are ended where anything is raised.
        workers: Number of workers, at most.
        counted: What parts and tasks are called in the display; an empty name where tasks are not counted.
        on_look: Called with the progress.

    Returns:
        Why a task has no result, by its key.

    Raises:
        InputError: where a result cannot be stored. What was stored stays.
    """
    n_workers = min(workers, sum(max(1, len(job.pending)) for job in jobs))
    jobs = firsts_first(jobs, lambda job: job.kind)
    tasks = TaskQueue(jobs, claims)
    tasks.claims.prepare()
    sizes, kinds = {job.key: job.size - job.done for job in jobs}, {job.key: job.kind for job in jobs}
    progress = Progress(counted[0], sizes, kinds, n_workers, counted[1])
    show = on_look or (lambda look: None)
    running = {Worker(tasks, children) for _ in range(n_workers)}
    errors: dict[str, str] = {}
    try:
        show(progress.look())
        for worker in tuple(running):
            worker.start()
        while running:
            event = tasks.events.get()
            if isinstance(event, BaseException):
                raise event
            if isinstance(event, Worker):
                running.remove(event)
            elif isinstance(event, str):
                say(event)
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


def say(line: str) -> None:
    """Log a warning, which the command line prints above a progress bar if there is one."""
    logging.getLogger("bench").warning(line)


def run_tasks(
    tasks: Sequence[StoredTask], folder: Path, limits: Limits, counted: tuple[str, str], on_look: OnLook | None = None
) -> dict[str, str]:
    """Compute and store the results of tasks that are not stored yet; see :func:`run_jobs`.

    The results and the claims are in ``folder``; the limit of time is each task's own.
    """
    jobs = [TaskJob(task, folder, limits.memory_mb) for task in tasks if not task.stored(folder)]
    if not jobs:
        return {}
    with Children(limits.preload) as children:
        return run_jobs(jobs, folder / "claims", children, limits.workers, counted, on_look)
