"""Cores and descriptors: what the system leaves this process, as opposed to what the machine has."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from conftest import Python

from bench.isolation.machine import quota_of_cores, usable_cores

ROOT = "sys/fs/cgroup"
IMPORTS = "import os, resource\nfrom bench.isolation.machine import *\n"


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="the system has no affinities")
def test_a_process_that_is_tied_to_one_core_has_one(python: Python) -> None:
    tied = "os.sched_setaffinity(0, {min(os.sched_getaffinity(0))}); print(usable_cores())"
    assert python("-c", IMPORTS + tied).stdout == "1\n"
    assert 1 <= usable_cores() <= (os.cpu_count() or 1)


@pytest.mark.parametrize(
    ("groups", "files", "cores"),
    [
        ("", {}, None),
        ("0::/", {f"{ROOT}/cpu.max": "max 100000"}, None),
        ("0::/", {f"{ROOT}/cpu.max": "nonsense"}, None),
        ("0::/", {f"{ROOT}/cpu.max": "150000 100000"}, 1.5),
        ("0::/box/inner", {f"{ROOT}/box/cpu.max": "200000 1000", f"{ROOT}/box/inner/cpu.max": "max 1000"}, 200.0),
    ],
    ids=["no groups", "no limit", "damaged", "one and a half", "of the group above"],
)  # fmt: skip
def test_the_quota_of_a_container_is_read(
    tmp_path: Path, groups: str, files: dict[str, str], cores: float | None
) -> None:
    for name, text in {"proc/self/cgroup": groups, **files}.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(f"{text}\n" if text else "")
    assert quota_of_cores(tmp_path) == cores
