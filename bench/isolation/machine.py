"""Resources of the machine: processor cores, open files, threads of libraries."""

from __future__ import annotations

import contextlib
import math
import os
import resource
from pathlib import Path

ROOT = Path("/")
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")


def usable_cores() -> int:
    """Return the number of cores that this process may use, by its affinity (``taskset``) and the container's quota."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    quota = quota_of_cores()
    return max(1, cores if quota is None else min(cores, math.ceil(quota - 1e-9)))


def quota_of_cores(root: Path = ROOT) -> float | None:
    """Return the smallest processor quota of this process's control groups (cores); None if there is none.

    It is stated in ``cpu.max`` (Linux kernel documentation, "Control Group v2"). ``root`` is the folder that contains
    ``proc`` and ``sys``.
    """
    quotas = []
    with contextlib.suppress(OSError):
        for line in (root / "proc/self/cgroup").read_text(encoding="utf-8").splitlines():
            group = Path(line.split(":", 2)[2].lstrip("/"))
            for folder in (group, *group.parents):
                with contextlib.suppress(OSError, ValueError):  # no limit
                    quota, period = map(int, (root / "sys/fs/cgroup" / folder / "cpu.max").read_text("ascii").split())
                    quotas.append(quota / period)
    return min(quotas, default=None)


def raise_file_limit() -> None:
    """Raise the soft limit of open file descriptors to the hard limit, for this process and its children."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != hard:
        with contextlib.suppress(OSError, ValueError):  # macOS rejects an infinite limit
            resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))


def single_threaded() -> None:
    """Restrict numerical libraries that are loaded later to one thread, since parallelism is over processes."""
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))


def compiled_single_threaded() -> None:
    """Restrict code that XLA compiles later to one thread, unless the user has set ``XLA_FLAGS``.

    A step of a tracker consists of some hundred small operations, for which threads only add overhead.
    """
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
