"""Where the blocks of an atlas are computed: in processes of this machine, or by Ray on those of a cluster.

Either is an executor of :mod:`concurrent.futures`. Results come through the folder of blocks alone, so on a cluster all
nodes must see it under the same path.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from importlib.util import find_spec
from multiprocessing import get_context
from typing import Any

from bench.errors import InputError

PROCESSES, RAY = "processes", "ray"
ENGINES = (PROCESSES, RAY)


def check_engine(engine: str) -> None:
    """Raise InputError where an engine is not installed."""
    if engine == RAY and find_spec(RAY) is None:
        raise InputError("engine", engine, "installed: pip install 'vibration-bench[ray]'")


def executor(engine: str, workers: int) -> Executor:
    """An executor of so many workers."""
    if engine == RAY:
        return _Ray()
    return ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_end_with_parent)


def capacity(engine: str, workers: int) -> int:
    """How many blocks are computed at a time: by Ray as many as its nodes have cores."""
    return int(_started_ray().cluster_resources().get("CPU", 1)) if engine == RAY else workers


class _Ray(Executor):
    """Tasks of Ray, of one core each, tried again where a node dies."""

    def __init__(self) -> None:
        self._ray = _started_ray()

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Hand a task to the cluster."""
        future: Future[Any] = self._ray.remote(fn).remote(*args, **kwargs).future()
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leave the cluster; what it still computes ends with this driver."""
        self._ray.shutdown()


def _started_ray() -> Any:
    """Ray, connected to the cluster that RAY_ADDRESS names, else started on this machine alone."""
    import ray

    if not ray.is_initialized():
        ray.init(address=os.environ.get("RAY_ADDRESS"), log_to_driver=False, include_dashboard=False)
    return ray


def parent_is_gone() -> bool:
    """Whether this is a worker process whose parent was killed."""
    return bool(_PARENT) and os.getppid() != _PARENT


def _end_with_parent() -> None:
    """A worker whose parent was killed ends at its next fit."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    global _PARENT
    _PARENT = os.getppid()


_PARENT = 0
