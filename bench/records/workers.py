"""Work on measured records in processes that are kept, some side by side, each task within its limits.

The process that asks only waits for messages, so that a signal ends it at once, and with it all workers.
"""

from __future__ import annotations

import pickle
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from multiprocessing.connection import wait
from typing import Any

from bench.errors import InputError
from bench.isolation.processes import Child, Children, Died

AT_ONCE = 2
"""Workers side by side."""
LOOK_S = 0.25
"""Interval at which the limits of workers are looked at (s)."""
READ_S = 60.0
"""Limit of reading a result that has begun to come (s)."""
PRELOADED = ("bench.records.find", "bench.records.replicas", "bench.records.what_if")
"""Modules that workers find imported."""


@dataclass(frozen=True)
class Call:
    """A call of a module's function with its limits of time (s) and of resident memory (MB)."""

    work: Callable[..., Any]
    arguments: tuple[Any, ...]
    limit_s: float
    memory_mb: float = 4096.0


class Workers:
    """Processes that perform tasks; to be used in a ``with`` block, at whose end they are killed."""

    def __init__(self) -> None:
        self._children = Children(PRELOADED)
        self._idle: list[Child] = []

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *raised: object) -> None:
        self._children.close()

    def perform(self, tasks: Iterable[Call], keep: bool = False) -> Iterator[tuple[int, Any]]:
        """Perform tasks side by side; yield the number and the result of each as it ends.

        ``keep`` the processes for tasks alike, which then find their programmes compiled; the memory of unlike ones
        would add up. The result of a task that went beyond a limit, or whose process ended, is a ``Died``.

        Raises:
            InputError: A task raised one.
        """
        waiting, busy = deque(enumerate(tasks)), dict[Child, tuple[int, Call, float]]()
        while waiting or busy:
            while waiting and len(busy) < AT_ONCE:
                child = self._idle.pop() if self._idle else self._children.start(_serve)
                number, task = waiting.popleft()
                child.send(pickle.dumps((task.work, task.arguments)))
                busy[child] = (number, task, time.monotonic())
            ready = wait([child.connection for child in busy], LOOK_S)
            for child, (number, task, started) in list(busy.items()):
                over = None if child.connection in ready else _over(child, task, time.monotonic() - started)
                if child.connection not in ready and over is None:
                    continue
                del busy[child]
                yield number, self._result(child, over, keep)

    def one(self, task: Call) -> Any:
        """Perform one task; raises Died where it went beyond a limit or its process ended."""
        ((_, result),) = self.perform([task])
        if isinstance(result, Died):
            raise result
        return result

    def _result(self, child: Child, over: Died | None, keep: bool) -> Any:
        if over is not None:
            child.kill()
            return over
        try:
            result = pickle.loads(child.receive(READ_S))
        except Died as died:
            return died
        if keep:
            self._idle.append(child)
        else:
            child.retire()
        if isinstance(result, InputError):
            raise result
        return result


def _over(child: Child, task: Call, seconds: float) -> Died | None:
    if seconds > task.limit_s:
        return Died("timeout", f"stopped after the limit of {task.limit_s:.3g} s", "")
    if child.resident_mb() > task.memory_mb:
        return Died("oom", f"stopped at the memory limit of {task.memory_mb:g} MB", "")
    return None


def _serve(connection: Any) -> None:
    """Perform one task after another until nobody asks any more."""
    while True:
        work, arguments = pickle.loads(connection.recv_bytes())
        try:
            result = work(*arguments)
        except InputError as error:
            result = error
        connection.send_bytes(pickle.dumps(result))
