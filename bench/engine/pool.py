"""The pool of processes: tasks are claimed, performed within limits of time and memory, and counted.

Each worker is a thread of the driver with processes of its own, which it ends when they hang, die or grow too large. A
task whose result is stored is not performed again, and one that another driver has claimed is waited for.
"""

from __future__ import annotations

import json
import math
import multiprocessing
import pickle
import queue
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Protocol

from bench.engine.progress import Kind, OnLook, Progress, firsts_first
from bench.errors import InputError
from bench.isolation.descriptors import affordable_workers
from bench.isolation.failure import one_line
from bench.isolation.processes import READY_S, Child, Children, Died
from bench.store.locks import Claims

WORKERS_A_WRITER = 4
COMPLETE_A_WRITER = 8
"""Tasks that wait for a writer, at most: enough that it never waits, and few, since each holds a claim."""
WAIT_S = 0.5
PATIENCE_S = 3.0
"""Time that a driver waits for another before it prints a line."""


@dataclass(frozen=True)
class Limits:
    """Limits of a run: ``timeout_s`` and ``memory_mb`` of one fit; ``preload``: packages that are imported once."""

    workers: int = 1
    timeout_s: float = 600.0
    memory_mb: float = 4096.0
    preload: tuple[str, ...] = ()


class Task(Protocol):
    """A piece of work with a stored result, e.g. a block of the atlas. It is pickled into a process of the pool."""

    @property
    def key(self) -> str:
        """Return a digest of all that the result depends on."""

    @property
    def kind(self) -> Kind:
        """Return which tasks cost as much."""

    @property
    def size(self) -> int:
        """Return the number of fits."""

    @property
    def limit_s(self) -> float:
        """Return the limit of time."""

    def stored(self, folder: Path) -> bool:
        """Return whether the result is stored whole."""

    def compute(self, folder: Path) -> None:
        """Compute and store the result; raises InputError where it cannot be stored."""


class Stopped(Exception):
    """The run is over: a process that ended with it has not failed."""


@dataclass(frozen=True)
class Done:
    """Parts of a task that are done: see :meth:`Progress.add`. ``error``: why there is no result."""

    queued: Queued
    n: int
    seconds: float = math.nan
    start_s: float = 0.0
    failed: int = 0
    error: str = ""


class Queued(ABC):
    """A task as the driver sees it: it has parts, which workers take one after another."""

    key: str
    kind: Kind
    name: str
    together: int
    """Number of parts that a worker performs in one step, at least."""
    started: float = 0.0
    """Time at which it was claimed (seconds since the epoch)."""

    @property
    @abstractmethod
    def open(self) -> int:
        """Return the number of parts that no worker has taken."""

    @property
    @abstractmethod
    def complete(self) -> bool:
        """Return whether all parts are done."""

    @abstractmethod
    def stored(self) -> bool:
        """Return whether another driver has stored the result since the plan."""

    @abstractmethod
    def take(self) -> Any:
        """Take the next parts."""

    @abstractmethod
    def put_back(self, parts: Any) -> None:
        """Return parts that are to be tried again."""

    @abstractmethod
    def perform(self, parts: Any, worker: Worker) -> Any:
        """Perform parts in the processes of a worker; None where they are to be tried again."""

    @abstractmethod
    def add(self, outcome: Any, seconds: float, first: bool) -> Done:
        """Keep the outcome of :meth:`perform`, which took a worker ``seconds``, maybe as the first of the task."""

    def prepare(self) -> None:  # noqa: B027
        """Do in advance, while the first tasks are performed, what :meth:`finish` needs."""

    def leave(self, worker: Worker) -> None:  # noqa: B027
        """End processes of a worker that serve this task only."""

    def finish(self, thread: RunThread | None) -> None:  # noqa: B027
        """Deal with a complete task, in a writer where the run has any."""


class QueuedTask(Queued):
    """A :class:`Task`, which one call in one process performs."""

    def __init__(self, task: Task, folder: Path, limits: Limits) -> None:
        self.task, self.folder, self.limits = task, folder, limits
        self.key, self.kind = task.key, task.kind
        self.name, self.together = " ".join(task.kind), task.size
        self._state = "open"

    @property
    def open(self) -> int:
        return self.task.size if self._state == "open" else 0

    @property
    def complete(self) -> bool:
        return self._state == "complete"

    def stored(self) -> bool:
        return self.task.stored(self.folder)

    def take(self) -> Task:
        self._state = "taken"
        return self.task

    def put_back(self, parts: Any) -> None:
        self._state = "open"

    def perform(self, parts: Any, worker: Worker) -> str:
        """Perform the task; returns why it has no result, or an empty string."""
        try:
            worker.request(serve_tasks, pickle.dumps((parts, self.folder)))
            answer = json.loads(worker.answer(serve_tasks, parts.limit_s, self.limits.memory_mb))
        except Died as died:
            worker.go_on()
            return died.message
        if "refused" in answer:
            raise InputError(*map(str, answer["refused"]))
        return str(answer["error"])

    def add(self, outcome: Any, seconds: float, first: bool) -> Done:
        self._state = "complete"
        n = self.task.size
        return Done(self, n, seconds, failed=n if outcome else 0, error=outcome)


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
    """The tasks of a run, shared by its threads: each call is one step under a lock.

    No task is begun while ``most_complete`` wait to be finished: each holds a claim.
    """

    def __init__(self, queued: Sequence[Queued], claims: Path, most_complete: int = COMPLETE_A_WRITER) -> None:
        self.claims = Claims(claims)
        self.events: queue.Queue[Any] = queue.Queue()
        self.complete: queue.Queue[Queued | None] = queue.Queue()
        """Tasks to be finished; None: no further task comes."""
        self.most_complete = most_complete
        self.all = tuple(queued)
        self._waiting = deque(queued)
        self._open: list[Queued] = []
        self._changed = threading.Condition()
        self._stopped = threading.Event()
        self._waited_since: float | None = None

    @property
    def more(self) -> bool:
        """Return whether there are tasks that no worker has begun."""
        return bool(self._waiting)

    @property
    def stopped(self) -> bool:
        """Return whether the run is over."""
        return self._stopped.is_set()

    def stop(self) -> None:
        """End the run."""
        self._stopped.set()
        self.complete.put(None)
        with self._changed:
            self._changed.notify_all()

    def take(self, last: Queued | None) -> tuple[Queued, Any] | None:
        """Return a task and the parts to be performed next, of the last task if it has any; None at the end.

        The parts of a task are shared among workers only when no task is left that no worker has begun.
        """
        with self._changed:
            while not self.stopped:
                if last is not None and last.open:
                    return last, last.take()
                room = sum(queued.complete for queued in self._open) < self.most_complete
                queued = (self._claimed() if room else None) or max(self._open, key=lambda one: one.open, default=None)
                if queued is not None and queued.open:
                    return queued, queued.take()
                if not self._waiting:
                    return None
                if not self._open:
                    self._report_waiting()
                self._changed.wait(WAIT_S)  # for room, or for tasks that another driver has claimed
        return None

    def _report_waiting(self) -> None:
        """Print once, after a while, that all that is left is claimed by other drivers."""
        now = time.monotonic()
        if self._waited_since is None:
            self._waited_since = now
        elif now - self._waited_since > PATIENCE_S:
            self._waited_since = math.inf
            holder = self.claims.holder(self._waiting[0].key)
            line = f"waiting for another run on this store (cells left: {len(self._waiting)}): {holder}"
            self.events.put(line)

    def _claimed(self) -> Queued | None:
        """Claim the next task that no driver works on; one that another has stored meanwhile is done."""
        for _ in range(len(self._waiting)):
            queued = self._waiting.popleft()
            if not self.claims.take(queued.key):
                self._waiting.append(queued)
                continue
            if queued.stored():
                self.claims.release(queued.key)
                self.events.put(Done(queued, queued.open))
                continue
            queued.started = time.time()
            self._open.append(queued)
            if queued.open:
                return queued
            self.complete.put(queued)
            self.events.put(Done(queued, 0))
        return None

    def put_back(self, queued: Queued, parts: Any) -> None:
        """Return parts of a task that are to be tried again."""
        with self._changed:
            queued.put_back(parts)

    def add(self, queued: Queued, outcome: Any, seconds: float, first: bool) -> None:
        """Keep an outcome; a task that is then complete is to be finished."""
        with self._changed:
            done = queued.add(outcome, seconds, first)
            if queued.complete:
                self.complete.put(queued)
            self.events.put(done)

    def close(self, queued: Queued) -> None:
        """Give up the claim of a task that is finished."""
        with self._changed:
            self._open.remove(queued)
            self.claims.release(queued.key)
            self._changed.notify_all()


class RunThread(threading.Thread, ABC):
    """A thread of the driver with processes of its own, by the function that they serve; errors become events."""

    def __init__(self, tasks: TaskQueue, children: Children) -> None:
        super().__init__(daemon=True)
        self.tasks, self.children = tasks, children
        self.processes: dict[Hashable, Child] = {}

    @abstractmethod
    def work(self) -> None:
        """Work until there is nothing more to do."""

    def run(self) -> None:
        """Work, and report what is raised."""
        try:
            self.work()
            for role in tuple(self.processes):
                self.retire(role)
        except Stopped:
            pass
        except BaseException as error:
            self.tasks.events.put(error)
        finally:
            self.tasks.events.put(self)

    def request(self, serve: Callable[[Connection], None], message: bytes) -> None:
        """Send a message to the process that serves a function; it is started where there is none."""
        if serve not in self.processes:
            child = self.children.start(serve)
            child.receive(READY_S)
            self.processes[serve] = child
        self.processes[serve].send(message)

    def answer(self, serve: Hashable, limit_s: float, memory_mb: float | None = None) -> bytes:
        """Return the answer to the last request; raises Died where the process ended or exceeded a limit."""
        try:
            return self.processes[serve].receive(limit_s, memory_mb)
        except Died:
            del self.processes[serve]
            raise

    def retire(self, role: Hashable) -> None:
        """Let a process end, if there is one."""
        if child := self.processes.pop(role, None):
            child.retire()

    def go_on(self) -> None:
        """Raise Stopped where the run is over."""
        if self.tasks.stopped:
            raise Stopped


class Worker(RunThread):
    """Performs tasks."""

    def work(self) -> None:
        queued: Queued | None = None
        while (taken := self.tasks.take(queued)) is not None:
            first, started = taken[0] is not queued, time.monotonic()
            if first and queued is not None:
                queued.leave(self)
            queued, parts = taken
            outcome = queued.perform(parts, self)
            if outcome is None:
                self.tasks.put_back(queued, parts)
            else:
                self.tasks.add(queued, outcome, time.monotonic() - started, first)
        if queued is not None:
            queued.leave(self)


class Writer(RunThread):
    """Finishes complete tasks."""

    def work(self) -> None:
        for queued in self.tasks.all:
            queued.prepare()
        while (complete := self.tasks.complete.get()) is not None:
            complete.finish(self)
            self.tasks.close(complete)
        self.tasks.complete.put(None)  # for the other writers


def run_queued(
    queued: Sequence[Queued],
    claims: Path,
    children: Children,
    workers: int,
    counted: tuple[str, str],
    on_look: OnLook | None = None,
    written: bool = False,
) -> dict[str, str]:
    """Perform tasks.

    Args:
        queued: The tasks.
        claims: Folder of the claims.
        children: The processes of the run; they are ended where anything is raised.
        workers: Number of workers, at most.
        counted: What parts and tasks are called in the display; an empty name where tasks are not counted.
        on_look: Called with the progress.
        written: Whether tasks are finished by writers; else this thread does it.

    Returns:
        Why a task has no result, by its key.

    Raises:
        InputError: where a result cannot be stored. What was stored stays.
    """
    n_workers = min(_affordable(workers), sum(max(1, one.open) for one in queued))
    n_writers = -(-n_workers // WORKERS_A_WRITER) if written else 0
    queued = firsts_first(queued, lambda one: one.kind)
    tasks = TaskQueue(queued, claims, COMPLETE_A_WRITER * max(1, n_writers))
    tasks.claims.prepare()
    sizes, kinds = {one.key: one.open for one in queued}, {one.key: one.kind for one in queued}
    progress = Progress(counted[0], sizes, kinds, n_workers, {one.kind: one.together for one in queued}, counted[1])
    show = on_look or (lambda look: None)
    show(progress.begin())
    performing = [Worker(tasks, children) for _ in range(n_workers)]
    running: set[RunThread] = {*performing, *(Writer(tasks, children) for _ in range(n_writers))}
    errors: dict[str, str] = {}
    try:
        for thread in tuple(running):
            thread.start()
        while running:
            event = tasks.events.get()
            if isinstance(event, BaseException):
                raise event
            if isinstance(event, RunThread):
                running.remove(event)
                if n_writers and not running.intersection(performing):
                    tasks.complete.put(None)
            elif isinstance(event, Done):
                key = event.queued.key
                if event.error:
                    errors[key] = event.error
                show(progress.add(key, event.n, event.seconds, event.start_s, event.failed, event.queued.name))
            else:
                say(event)
            while not n_writers and not tasks.complete.empty():
                complete = tasks.complete.get()
                assert complete is not None
                complete.finish(None)
                tasks.close(complete)
    except BaseException:
        tasks.stop()
        children.close()
        raise
    finally:
        tasks.stop()
        tasks.claims.release_all()
    return errors


def _affordable(workers: int) -> int:
    """Return how many workers there are open files for; prints a line where files are too few."""
    enough = affordable_workers(workers)
    if enough < workers:
        say(f"{enough} workers instead of {workers}: more need more open files than the system gives (ulimit -n)")
    return enough


def say(line: str) -> None:
    """Print a line on the error stream, above a progress bar if there is one."""
    print(f"bench: {line}", file=sys.stderr)


def run_tasks(
    tasks: Sequence[Task], folder: Path, limits: Limits, counted: tuple[str, str], on_look: OnLook | None = None
) -> dict[str, str]:
    """Compute and store the results of tasks that are not stored yet.

    Args:
        tasks: The tasks.
        folder: Where the results are stored, and the claims.
        limits: Of the run; the limit of time is each task's own.
        counted: What fits and tasks are called in the display; an empty name where tasks are not counted.
        on_look: Called with the progress.

    Returns:
        Why a task has no result, by its key.

    Raises:
        InputError: where a result cannot be stored. What was stored stays.
    """
    missing = [QueuedTask(task, folder, limits) for task in tasks if not task.stored(folder)]
    if not missing:
        return {}
    with Children(limits.preload) as children:
        return run_queued(missing, folder / "claims", children, limits.workers, counted, on_look)
