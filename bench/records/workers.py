"""Worker processes for measured records, which perform calls in parallel within limits of time and memory.

The parent process only waits, so that a signal ends it and its workers at once.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from bench.errors import InputError
from bench.isolation.processes import Child, Children

AT_ONCE = 2
"""Number of processes."""
MEMORY_MB = 4096.0
"""Default limit of the resident memory of a process (MB)."""
PRELOADED = ("bench.records.identification", "bench.records.replicas", "bench.records.what_if")
"""Modules imported by the server from which the processes are forked."""


class Workers:
    """Worker processes, to be used in a ``with`` block, at whose end they are killed.

    A process performs several calls in turn and keeps its imports and compiled functions.

    Args:
        preload: Modules imported by the server from which the processes are forked.
    """

    def __init__(self, preload: Sequence[str] = PRELOADED) -> None:
        self._children = Children(preload)
        self._threads = ThreadPoolExecutor(AT_ONCE)  # each waits for the result of a process
        self._idle: list[Child] = []

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *raised: object) -> None:
        self._children.close()
        self._threads.shutdown(cancel_futures=True)

    def submit(
        self, limit_s: float, work: Callable[..., Any], *arguments: Any, memory_mb: float = MEMORY_MB
    ) -> Future[Any]:
        """Call a function of a module as soon as a process is free.

        Args:
            limit_s: Time limit (s).
            work: The function.
            arguments: Its arguments.
            memory_mb: Memory limit (MB).

        Returns:
            A future of the result; it raises Died if the call exceeds a limit or its process dies, and InputError if
            the function does.
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
    """Perform calls until the connection closes."""
    while True:
        work, arguments = pickle.loads(connection.recv_bytes())
        try:
            result = work(*arguments)
        except InputError as error:
            result = error
        connection.send_bytes(pickle.dumps(result))
