"""What this machine leaves to a run: processor cores, open files, threads of libraries."""

from __future__ import annotations

import contextlib
import math
import os
import resource
from pathlib import Path

ROOT = Path("/")
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")


def usable_cores() -> int:
    """Return the cores that this process may run on (``taskset``), or fewer where a container has a quota."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    quota = quota_of_cores()
    return max(1, cores if quota is None else min(cores, math.ceil(quota - 1e-9)))


def quota_of_cores(root: Path = ROOT) -> float | None:
    """Return the smallest quota of processor time of this process's control groups (cores); None where none limits.

    Both generations are read: ``cpu.max`` of version 2, ``cpu.cfs_quota_us`` of version 1 (Linux kernel documentation,
    "Control Group v2" and "CFS Bandwidth Control"). ``root`` is the folder that holds ``proc`` and ``sys``.
    """
    quotas = []
    with contextlib.suppress(OSError):
        for line in (root / "proc/self/cgroup").read_text(encoding="utf-8").splitlines():
            _, controllers, place = line.split(":", 2)
            if controllers and "cpu" not in controllers.split(","):
                continue
            group = Path(place.lstrip("/"))
            mounts = ("cpu", controllers) if controllers else ("",)
            folders = [root / "sys/fs/cgroup" / mount / part for mount in mounts for part in (group, *group.parents)]
            quotas += [_quota(folder) for folder in folders]
    return min((quota for quota in quotas if quota is not None), default=None)


def _quota(folder: Path) -> float | None:
    for names in (("cpu.max",), ("cpu.cfs_quota_us", "cpu.cfs_period_us")):
        with contextlib.suppress(OSError, ValueError):  # another generation, or no limit
            quota, period = map(int, " ".join((folder / name).read_text("ascii") for name in names).split())
            return quota / period if quota > 0 else None
    return None


def raise_file_limit() -> None:
    """Raise the soft limit of open descriptors to the hard one, for this process and all that it starts."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != hard:
        with contextlib.suppress(OSError, ValueError):  # macOS has a limit of its own below an infinite one
            resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))


def single_threaded() -> None:
    """Fix numerical libraries loaded from now on to one thread: workers are processes, and share the cores."""
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))


def compiled_single_threaded() -> None:
    """Fix what XLA compiles from now on to one thread, where the user has not said otherwise.

    A tracker's step is a hundred small operations, each of which is over before another thread has taken it on.
    """
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
