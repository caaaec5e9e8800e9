"""What the harness adds to a method's own time, and what a sweep of a million cells would take.

    python -m tests.studies.sweeps.empty_cells [cells=5000]

Runs cells that take no time, and plans a store that holds all of them; the costs of a cell, of memory and of disk are
then multiplied. ``cells=1000000`` runs a million in fact.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Annotated

from tests.studies.common import Count, study
from tests.studies.sweeps.common import start, stored_cells

CORES = 16
"""Of a node in the table of a million cells."""
FEW = 40


def timed(folder: Path, *arguments: str) -> tuple[float, float]:
    """Run cells; return the seconds, and the largest memory of the driver (MB)."""
    started = time.perf_counter()
    process = start(folder, *arguments, "replicates=1", "workers=2")
    assert process.stdout is not None
    process.stdout.read()
    _, status, used = os.wait4(process.pid, 0)
    assert status == 0, (folder / "bench.log").read_text()
    return time.perf_counter() - started, used.ru_maxrss / 1024


def empty_cells(cells: Annotated[Count, "cells that take no time"] = 5000) -> int:
    """Print the costs; exit status 1 where the harness costs more than 15 ms a cell."""
    cells = 4 * (cells // 4)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        sweep = ["-m", "method=stand_in", "snr=40,30,20,10"]
        timed(folder, *sweep, "seed=100000")  # the bound, and the file caches
        first_s, first_mb = timed(folder, *sweep, f"seed=range(200000,{200000 + FEW // 4})")
        all_s, all_mb = timed(folder, *sweep, f"seed=range(0,{cells // 4})")
        plan_s, _ = timed(folder, *sweep, f"seed=range(0,{cells // 4})", "dry_run=true")
        store = folder / "outputs/rows"
        assert len(stored_cells(store)) == cells + FEW + 4
        size = sum(path.stat().st_size for path in store.rglob("*") if path.is_file()) / (cells + FEW + 4)
    each_s, each_mb = (all_s - first_s) / (cells - FEW), max(all_mb - first_mb, 0.0) / (cells - FEW)
    print(f"{cells} empty cells on 2 workers: {1000 * all_s / cells:.1f} ms a cell, start of the run included")
    print(f"({FEW} cells take {first_s:.1f} s; each further cell {1000 * each_s:.2f} ms)")
    print(f"driver: {all_mb:.0f} MB, {1000 * each_mb:.1f} kB a cell; store: {size / 1000:.1f} kB a cell")
    print(f"planning all of them again: {plan_s:.1f} s")
    hours = {nodes: 2e6 * each_s / (nodes * CORES) / 3600 for nodes in (1, 10, 100)}
    print("a million empty cells:", ", ".join(f"{time:.2f} h on {n} x {CORES} cores" for n, time in hours.items()))
    print(f"  {1000 * each_mb:.1f} GB in the driver, {size / 1000:.1f} GB in the store")
    return int(all_s / cells > 0.015)


if __name__ == "__main__":
    sys.exit(study(empty_cells, "tests.studies.sweeps.empty_cells"))
