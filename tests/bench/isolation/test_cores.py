"""Cores and descriptors: what the system leaves this process, as opposed to what the machine has."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from bench.isolation.cores import quota_of_cores, usable_cores
from bench.isolation.descriptors import A_WORKER, affordable_workers


def run(script: str) -> str:
    return subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=60).stdout


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="the system has no affinities")
def test_a_process_that_is_tied_to_one_core_has_one() -> None:
    script = "import os; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\n"
    assert run(f"{script}from bench.isolation.cores import usable_cores; print(usable_cores())") == "1\n"
    assert 1 <= usable_cores() <= (os.cpu_count() or 1)


def written(root: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


@pytest.mark.parametrize(
    ("files", "cores"),
    [
        ({}, None),
        ({"proc/self/cgroup": "0::/\n", "sys/fs/cgroup/cpu.max": "max 100000\n"}, None),
        ({"proc/self/cgroup": "0::/\n", "sys/fs/cgroup/cpu.max": "150000 100000\n"}, 1.5),
        (
            {
                "proc/self/cgroup": "0::/box/inner\n",
                "sys/fs/cgroup/box/cpu.max": "200000 100000\n",
                "sys/fs/cgroup/box/inner/cpu.max": "max 100000\n",
            },
            2.0,
        ),
        (
            {
                "proc/self/cgroup": "4:memory:/box\n3:cpu,cpuacct:/box\n",
                "sys/fs/cgroup/cpu,cpuacct/box/cpu.cfs_quota_us": "300000\n",
                "sys/fs/cgroup/cpu,cpuacct/box/cpu.cfs_period_us": "100000\n",
                "sys/fs/cgroup/cpu,cpuacct/cpu.cfs_quota_us": "-1\n",
                "sys/fs/cgroup/cpu,cpuacct/cpu.cfs_period_us": "100000\n",
            },
            3.0,
        ),
        ({"proc/self/cgroup": "0::/\n", "sys/fs/cgroup/cpu.max": "nonsense"}, None),
    ],
    ids=["no groups", "no limit", "one and a half", "of the group above", "first generation", "damaged"],
)
def test_the_quota_of_a_container_is_read_whichever_generation_it_is_of(
    tmp_path: Path, files: dict[str, str], cores: float | None
) -> None:
    assert quota_of_cores(written(tmp_path, files)) == cores


def test_there_are_no_more_workers_than_descriptors_suffice_for() -> None:
    """Of a limit of 128 some are taken and some reserved: a worker cannot have more than its part."""
    script = f"import resource; resource.setrlimit(resource.RLIMIT_NOFILE, (128, {resource.getrlimit(7)[1]}))\n"
    take = "from bench.isolation.descriptors import affordable_workers; print(affordable_workers(11))"
    found = int(run(script + take))
    assert 1 <= found <= 128 // A_WORKER
    assert affordable_workers(1) == 1


def test_the_limit_is_raised_as_far_as_it_may_be() -> None:
    script = (
        "import resource; hard = min(resource.getrlimit(resource.RLIMIT_NOFILE)[1], 500)\n"
        "resource.setrlimit(resource.RLIMIT_NOFILE, (64, hard))\n"
        "from bench.isolation.descriptors import raise_limit; raise_limit()\n"
        "print(resource.getrlimit(resource.RLIMIT_NOFILE)[0] == hard)"
    )
    assert run(script) == "True\n"
