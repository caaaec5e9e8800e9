"""What this machine leaves to a run: processor cores, open files, a folder for sockets, threads of libraries."""

from __future__ import annotations

import contextlib
import math
import os
import resource
import tempfile
from pathlib import Path

from bench.errors import InputError

ROOT = Path("/")
LONGEST_TMPDIR = 75
"""Letters of the path: that of a socket is at most 107 on Linux, and Python puts 32 behind the folder's."""
RESERVED_FILES = 32
"""Descriptors kept free for the server of processes, for the store, and for what imports open."""
FILES_A_WORKER = 16
"""Descriptors of a worker: three processes of three each, claims, and the copies of a start."""
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


def affordable_workers(wanted: int) -> int:
    """Return how many of the wanted workers the free descriptors suffice for, at least one."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY:
        return wanted
    return max(1, min(wanted, (soft - len(os.listdir("/dev/fd")) - RESERVED_FILES) // FILES_A_WORKER))


def check_temporary() -> None:
    """Raise InputError where no temporary file can be made, or the path is too long for a socket in it."""
    try:
        folder = tempfile.gettempdir()
    except OSError as error:
        remedy = f"a folder that can be written ({error.strerror})"
        raise InputError("TMPDIR", os.environ.get("TMPDIR", ""), remedy) from None
    if len(os.fsencode(folder)) > LONGEST_TMPDIR:
        remedy = f"a path of at most {LONGEST_TMPDIR} letters, which has room for a socket's name"
        raise InputError("TMPDIR", folder, remedy)


def single_threaded() -> None:
    """Fix numerical libraries loaded from now on to one thread: workers are processes, and share the cores."""
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))


def compiled_single_threaded() -> None:
    """Fix what XLA compiles from now on to one thread, where the user has not said otherwise.

    A tracker's step is a hundred small operations, each of which is over before another thread has taken it on.
    """
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
