"""How many processor cores this process may use: of the machine, its affinity and the limits of its control groups."""

from __future__ import annotations

import math
import os
from pathlib import Path

ROOT = Path("/")


def usable_cores() -> int:
    """At least 1: the cores that the process may run on (``taskset``), or fewer where a container has a quota."""
    if hasattr(os, "sched_getaffinity"):
        cores = len(os.sched_getaffinity(0))
    else:
        cores = os.cpu_count() or 1
    quota = quota_of_cores()
    return max(1, cores if quota is None else min(cores, math.ceil(quota - 1e-9)))


def quota_of_cores(root: Path = ROOT) -> float | None:
    """The smallest quota of processor time over the control groups of this process, in cores; None where none limits.

    Both generations are read: ``cpu.max`` of version 2, ``cpu.cfs_quota_us`` of version 1 (Linux kernel documentation,
    "Control Group v2" and "CFS Bandwidth Control"). ``root`` is the folder that holds ``proc`` and ``sys``.
    """
    found = [quota for folder in _groups(root) if (quota := _quota(folder)) is not None]
    return min(found, default=None)


def _groups(root: Path) -> list[Path]:
    """The folders of the process's control groups and of all above them, which limit it as well."""
    try:
        lines = (root / "proc/self/cgroup").read_text(encoding="utf-8").splitlines()
    except OSError:
        return []
    found = []
    for line in lines:
        _, _, rest = line.partition(":")
        controllers, _, path = rest.partition(":")
        if controllers and "cpu" not in controllers.split(","):
            continue
        mounts = ["sys/fs/cgroup"] if not controllers else ["sys/fs/cgroup/cpu", f"sys/fs/cgroup/{controllers}"]
        own = Path(path.lstrip("/"))
        found += [root / mount / part for mount in mounts for part in (own, *own.parents)]
    return found


def _quota(folder: Path) -> float | None:
    for read in (_second_generation, _first_generation):
        try:
            return read(folder)
        except (OSError, ValueError):  # another generation, or no limit
            continue
    return None


def _second_generation(folder: Path) -> float:
    quota, period = (folder / "cpu.max").read_text(encoding="ascii").split()
    return int(quota) / int(period)


def _first_generation(folder: Path) -> float:
    quota, period = (int((folder / f"cpu.cfs_{name}_us").read_text("ascii")) for name in ("quota", "period"))
    if quota <= 0:
        raise ValueError("no limit")
    return quota / period
