"""A sweep on two Ray nodes, of which one loses a worker and the other dies: what is stored, and how often.

    python -m tests.studies.sweeps.ray_nodes

Both nodes are on this machine, in namespaces with no network but loopback. Everything else is in a temporary folder.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import signal
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import psutil

from tests.studies.sweeps.common import Journal, environment, finish, report, run_apart, start, stored_cells, wait_for

CELLS = 200
SWEEP = (
    "-m", "method=stand_in", "method.seconds=0.2", f"seed=range({CELLS})", "replicates=2", "cells_per_job=5",
    "store=rows", "hydra/launcher=ray", "hydra.launcher.ray.init.address=auto",
)  # fmt: skip
PORT, SLOTS = 6399, 2
BUSY = "ray::_run_job"
"""What Ray calls a worker while it is at the function of Hydra's launcher."""


def main() -> int:
    """Run, or say in one line why not."""
    missing = next((name for name in ("ray", "hydra_plugins.hydra_ray_launcher") if find_spec(name) is None), "")
    reason = f"{missing} is not installed (pip install 'vibration-bench[ray]')" if missing else ""
    return run_apart("tests.studies.sweeps.ray_nodes", (), reason, _inside)


def _inside(folder: Path) -> int:
    os.environ |= {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32), "RAY_USAGE_STATS_ENABLED": "0"}
    head = _node(folder, "--head", f"--port={PORT}", "--include-dashboard=false", f"--temp-dir={folder / 'head'}")
    other = _node(folder, f"--address=127.0.0.1:{PORT}")
    store = folder / "rows"
    store.mkdir()
    journal = Journal(store)
    driver = start(folder, *SWEEP)
    for cells, raylet, whole in ((CELLS // 5, head, False), (CELLS // 2, other, True)):
        _wait_for_cells(journal, cells, driver)
        victims = [raylet, *_processes(raylet)] if whole else _busy_workers(raylet)[:1]
        for pid in victims:
            with contextlib.suppress(ProcessLookupError):  # it ended with its parent
                os.kill(pid, signal.SIGKILL)
        print(f"killed {len(victims)} process(es) at {len(journal.stored())} cells")
    status, _ = finish(driver)
    times = dict(journal.stored())
    again, _ = finish(start(folder, *SWEEP))
    rows = [
        ("exit status", status, 0),
        ("cells in the store", len(stored_cells(store)), CELLS),
        ("cells stored more than once", sum(n > 1 for n in times.values()), 0),
        ("temporary files left", len(list(store.glob("*.tmp"))), 0),
        ("exit status of a second run", again, 0),
        ("cells that it computed", sum(journal.stored().values()) - sum(times.values()), 0),
    ]
    return report("two Ray nodes, a worker and a node killed", rows)


def _wait_for_cells(journal: Journal, cells: int, driver: subprocess.Popen[str]) -> None:
    wait_for(lambda: len(journal.stored()) >= cells or driver.poll() is not None, f"{cells} cells", 600)


def _processes(raylet: int) -> list[int]:
    """Return the processes of a node below its raylet: its agents and workers, and the processes of methods."""
    return [child.pid for child in psutil.Process(raylet).children(recursive=True)]


def _busy_workers(raylet: int) -> list[int]:
    """Return the processes of a node that are at a job; a raylet ends with its agents, which are its children too."""
    return [child.pid for child in psutil.Process(raylet).children() if child.name() == BUSY]


def _node(folder: Path, *options: str) -> int:
    """Start a node whose workers find the stand-in; return the process that they are all children of."""
    before = _raylets()
    ray = str(Path(sys.executable).with_name("ray"))
    own = ["--node-ip-address=127.0.0.1", f"--num-cpus={SLOTS}", "--object-store-memory=80000000"]
    command = [ray, "start", *options, *own, "--disable-usage-stats"]
    subprocess.run(command, env=environment(folder), check=True, capture_output=True, timeout=120)
    return next(iter(_raylets() - before))


def _raylets() -> set[int]:
    return {process.pid for process in psutil.process_iter() if process.name() == "raylet"}


if __name__ == "__main__":
    sys.exit(main())
