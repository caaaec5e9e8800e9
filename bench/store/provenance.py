"""Provenance of a result: commit, packages, machine, and time."""

from __future__ import annotations

import os
import platform
import subprocess
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

from bench.store.version import Version, installed


@cache
def commit() -> dict[str, Any]:
    """Return the commit of this checkout and whether tracked files are modified; None outside a checkout."""
    root = Path(__file__).parents[2]
    if not (root / ".git").exists():
        return {"commit": None, "dirty": None}

    def git(*arguments: str) -> str:
        done = subprocess.run(["git", *arguments], cwd=root, capture_output=True, text=True, timeout=30, check=True)
        return done.stdout.strip()

    try:
        changed = git("status", "--porcelain", "--untracked-files=no", "--", ".", ":(exclude)results")
        return {"commit": git("rev-parse", "HEAD"), "dirty": bool(changed)}
    except (OSError, subprocess.SubprocessError):
        return {"commit": None, "dirty": None}


@cache
def _machine() -> dict[str, Any]:
    return {
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
        "processor": _processor(),
        "cores": os.cpu_count(),
        "threads_per_fit": 1,
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor()


def circumstances(computed_by: Version) -> dict[str, Any]:
    """Return the packages and properties of the machine that may influence a result, by name."""
    machine = {name: _machine()[name] for name in ("python", "system", "processor")}
    return {"vibration-bench": installed("vibration-bench") or None, **computed_by.packages, **machine}


def provenance(
    computed_by: Version, workers: int, timeout_s: float, memory_mb: float, started: float
) -> dict[str, Any]:
    """Return the provenance of a cell.

    Args:
        computed_by: The version of the code.
        workers: Number of worker processes.
        timeout_s: Time limit per replicate, s.
        memory_mb: Memory limit per fit, MB.
        started: Time of the start, seconds since the epoch.
    """
    return {
        **commit(),
        **_machine(),
        "packages": {"vibration-bench": installed("vibration-bench") or None, **computed_by.packages},
        "workers": workers,
        "limits": {"timeout_s": timeout_s, "memory_mb": memory_mb},
        "started": datetime.fromtimestamp(started, UTC).isoformat(timespec="seconds"),
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
    }
