"""A sweep on two Ray nodes, of which one loses a worker and the other dies: what is stored, and how often.

    python -m tests.studies.sweeps.ray_nodes

Both nodes are on this machine, in namespaces with no network but loopback. Everything else is in a temporary folder.
"""

from __future__ import annotations

import os
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import psutil
from tabulate import tabulate

from bench.store.store import Store
from tests.studies.sweeps.apart import run_apart, wait_for, why_not
from tests.studies.sweeps.journal import Journal, held_claims

SEEDS = 100
SWEEP = ("method=ls,shooting", f"seed=range({SEEDS})", "replicates=2", "cells_per_job=5")
CELLS = 2 * SEEDS
SLOTS = 2  # of each node
PORT = 6399
RAY = ("hydra/launcher=ray", "hydra.launcher.ray.init.address=auto", "+hydra.launcher.ray.init.log_to_driver=false")


def main() -> int:
    """Run, or say in one line why not."""
    missing = next((name for name in ("ray", "hydra_plugins.hydra_ray_launcher") if find_spec(name) is None), "")
    reason = f"{missing} is not installed (pip install 'vibration-bench[ray]')" if missing else why_not()
    return run_apart("tests.studies.sweeps.ray_nodes", reason, _inside)


def _inside(folder: Path) -> int:
    os.environ |= {
        "RAY_AUTH_MODE": "token",
        "RAY_AUTH_TOKEN": secrets.token_hex(32),
        "RAY_USAGE_STATS_ENABLED": "0",
        "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
    }
    try:
        head = _node(folder / "head", "--head", f"--port={PORT}", "--include-dashboard=false")
        other = _node(folder / "other", f"--address=127.0.0.1:{PORT}")
        return _try(Store(folder / "rows"), head, other)
    except (RuntimeError, TimeoutError) as error:
        print(f"ray_nodes: {error}\n{_tail(folder / 'driver')}", file=sys.stderr)
        return 1


def _try(store: Store, head: int, other: int) -> int:
    store.prepare()
    journal = Journal(store.folder)
    started = time.monotonic()
    with (store.folder.parent / "driver").open("w+") as log:
        driver = subprocess.Popen(_command(store), stdout=log, stderr=log)
    rows, under_way = [], 0
    for share, what, victim in ((0.2, "a worker of the head", head), (0.5, "the other node", other)):
        _wait_for_cells(journal, round(share * CELLS), driver)
        before, lost = len(journal.stored()), _kill(store, victim, whole=what.endswith("node"))
        rows.append([f"killed {what}", f"{time.monotonic() - started:.0f}", before, len(lost)])
        under_way += len(lost)
    driver.wait(timeout=900)
    said = (store.folder.parent / "driver").read_text(encoding="utf-8")
    times = journal.stored()
    rows.append([f"end, exit status {driver.returncode}", f"{time.monotonic() - started:.0f}", len(times), ""])
    print(tabulate(rows, headers=["", "s", "cells stored", "cells under way there"]))
    here, twice = len(store.identities()), sum(n > 1 for n in times.values())
    again = subprocess.run(_command(store), capture_output=True, text=True)
    recomputed = sum(journal.stored().values()) - sum(times.values())
    summary = [
        ["cells of the sweep", CELLS],
        ["files of cells in the store at the end", here],
        ["cells that were stored more than once", twice],
        ["cells under way at a kill, computed anew", under_way],
        ["claims and temporary files left", _left_over(store)],
        [f"cells that a second run computed (exit status {again.returncode})", recomputed],
    ]
    print(tabulate(summary))
    for line in said.replace("\r", "\n").splitlines():
        if line.startswith("bench:"):
            print(line)
    good = here == CELLS and twice == 0 and recomputed == 0 and driver.returncode == again.returncode == 0
    if not good:
        print(said[-3000:], again.stderr[-2000:], sep="\n", file=sys.stderr)
    return 0 if good else 1


def _wait_for_cells(journal: Journal, wanted: int, driver: subprocess.Popen[bytes]) -> None:
    def there() -> bool:
        if driver.poll() is not None:
            raise RuntimeError(f"the sweep ended, with status {driver.returncode}, at {len(journal.stored())} cells")
        return len(journal.stored()) >= wanted

    wait_for(there, f"{wanted} cells", 600)


def _kill(store: Store, raylet: int, whole: bool) -> list[str]:
    """Kill a node, or one of its workers that computes a cell; returns the cells under way there."""
    claims: dict[str, int] = {}

    def computing() -> bool:
        nonlocal claims
        mine = _processes_of(raylet)
        claims = {cell: pid for cell, pid in held_claims(store.claims).items() if pid in mine}
        return bool(claims)

    wait_for(computing, "a cell under way", 120)
    victims = _processes_of(raylet) if whole else [next(iter(claims.values()))]
    for pid in victims:
        os.kill(pid, signal.SIGKILL)
    return [cell for cell, pid in claims.items() if pid in victims]


def _processes_of(pid: int) -> list[int]:
    """A process and all that it started."""
    return [pid, *(child.pid for child in psutil.Process(pid).children(recursive=True))]


def _tail(path: Path) -> str:
    return path.read_text(encoding="utf-8")[-3000:] if path.exists() else ""


def _left_over(store: Store) -> int:
    claims = store.claims.glob("*") if store.claims.is_dir() else ()
    return len([*claims, *store.folder.glob("*.tmp"), *store.folder.glob("launches/*")])


def _command(store: Store) -> list[str]:
    return [sys.executable, "-m", "bench", "-m", *SWEEP, f"store={store.folder}", *RAY]


def _ray() -> str:
    return str(Path(sys.executable).with_name("ray"))


def _node(folder: Path, *options: str) -> int:
    """Start a node; returns the process that all its workers are children of."""
    before = _raylets()
    own = ["--node-ip-address=127.0.0.1", f"--num-cpus={SLOTS}", "--object-store-memory=80000000"]
    temporary = [f"--temp-dir={folder}"] if "--head" in options else []
    command: Sequence[str] = [_ray(), "start", *options, *own, *temporary, "--disable-usage-stats"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
    return next(iter(_raylets() - before))


def _raylets() -> set[int]:
    listed = subprocess.run(["ps", "-eo", "pid=,comm="], capture_output=True, text=True, check=True).stdout
    return {int(line.split()[0]) for line in listed.splitlines() if line.split()[1] == "raylet"}


if __name__ == "__main__":
    sys.exit(main())
