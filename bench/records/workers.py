"""Calls on measured records in processes that are kept, some side by side, each call within its limits.

The process that asks only waits, so that a signal ends it at once, and with it all processes.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from bench.errors import InputError
from bench.isolation.processes import Child, Children

AT_ONCE = 2
"""Processes side by side."""
MEMORY_MB = 4096.0
"""Limit of the resident memory of a process, where a call names none."""
PRELOADED = ("bench.records.identification", "bench.records.replicas", "bench.records.what_if")
"""Modules that the processes find imported."""


class Workers:
    """Processes that perform calls; to be used in a ``with`` block, at whose end they are killed.

    A process performs one call after another, and finds imported and compiled what an earlier one needed.
    """

    def __init__(self, preload: Sequence[str] = PRELOADED) -> None:
        self._children = Children(preload)
        self._threads = ThreadPoolExecutor(AT_ONCE)  # a thread for each process, which waits for its answer
        self._idle: list[Child] = []

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *raised: object) -> None:
        self._children.close()
        self._threads.shutdown(cancel_futures=True)

    def submit(
        self, limit_s: float, work: Callable[..., Any], *arguments: Any, memory_mb: float = MEMORY_MB
    ) -> Future[Any]:
        """Call a module's function as soon as a process is free, within a limit of time (s) and of memory.

        The future raises Died where the call went beyond a limit or its process ended, and InputError where it did.
        """
        return self._threads.submit(self._perform, limit_s, memory_mb, (work, arguments))

    def _perform(self, limit_s: float, memory_mb: float, call: tuple[Callable[..., Any], tuple[Any, ...]]) -> Any:
        child = self._idle.pop() if self._idle else self._children.start(_serve)
        child.send(pickle.dumps(call))
        result = pickle.loads(child.receive(limit_s, memory_mb))
        self._idle.append(child)
        if isinstance(result, InputError):
            raise result
        return result


def _serve(connection: Any) -> None:
    """Perform one call after another until nobody asks any more."""
    while True:
        work, arguments = pickle.loads(connection.recv_bytes())
        try:
            result = work(*arguments)
        except InputError as error:
            result = error
        connection.send_bytes(pickle.dumps(result))
