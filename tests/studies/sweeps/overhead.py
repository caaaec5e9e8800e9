"""``python -m tests.studies.sweeps.overhead``: what the harness adds to a method's own time, and what two cores give.

1,000 cells that take no time, on two workers, against the same cells as jobs of Hydra's own multirun with its basic
launcher (which neither isolates, limits, resumes nor survives anything); and 200 cells of 0.5 s of processor time
against two bare processes that burn as much, in the same run. About 5 minutes.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from tests.studies.sweeps.common import bench, cell_files, environment, finish

CELLS, NAIVE = 1000, 40
BUSY, SECONDS = 200, 0.5
EMPTY_SWEEP = ("-m", "method=empty", "snr=40,30,20,10", "seed=range(0,250)", "replicates=1", "workers=2")
BUSY_SWEEP = ("-m", "method=busy", f"method.seconds={SECONDS}", "seed=range(0,200)", "replicates=1", "workers=2")
WARM = ("method=empty", "seed=100000", "replicates=1", "workers=2")
BURN = "from tests.studies.sweeps.doubles import burn\nfor _ in range({n}): burn({seconds})"


def timed(folder: Path, *arguments: str) -> float:
    """Seconds of a run of ``python -m bench``."""
    started = time.perf_counter()
    status, _ = finish(bench(folder, *arguments))
    assert status == 0, (folder / "bench.log").read_text()
    return time.perf_counter() - started


def naive(folder: Path, jobs: int) -> float:
    """Seconds of Hydra's multirun over the same cells."""
    command = [
        sys.executable, "-m", "tests.studies.sweeps.naive", "-m", f"seed=range(0,{jobs})", f"store={folder}/naive",
        f"hydra.sweep.dir={folder}/multirun",
    ]  # fmt: skip
    started = time.perf_counter()
    subprocess.run(command, cwd=folder, env=environment(folder), check=True, capture_output=True)
    return time.perf_counter() - started


def bare(folder: Path) -> float:
    """Seconds that two processes without any harness take for as much."""
    command = [sys.executable, "-c", BURN.format(n=BUSY // 2, seconds=SECONDS)]

    def run(_: int) -> None:
        subprocess.run(command, cwd=folder, env=environment(folder), check=True)

    started = time.perf_counter()
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(run, range(2)))
    return time.perf_counter() - started


def main() -> int:
    """Print the table; exit status 1 where a claim does not hold."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        timed(folder, *WARM)  # the bound, and the file caches
        start = timed(folder, "method=empty", "seed=100001", "replicates=1", "workers=2")
        empty = timed(folder, *EMPTY_SWEEP)
        assert len(cell_files(folder / "outputs/rows")) == CELLS + 2
        few, many = naive(folder, 2), naive(folder, NAIVE + 2)
        basic = 1000 * (many - few) / NAIVE
        ours, with_start = 1000 * (empty - start) / CELLS, 1000 * empty / CELLS
        alone = bare(folder)
        busy = timed(folder, *BUSY_SWEEP)
        print(f"{CELLS} empty cells on 2 workers: {with_start:.1f} ms a cell, start of the run included")
        print(f"  ({start:.1f} s for a run of one cell; without that {ours:.1f} ms a cell)")
        print(f"Hydra's basic launcher, same cells: {basic:.0f} ms a cell, {basic / with_start:.1f} times as much")
        print(f"{BUSY} cells of {SECONDS} s: {busy:.1f} s, two bare processes {alone:.1f} s: ratio {alone / busy:.3f}")
        good = with_start <= 15 and basic >= 5 * with_start and alone / busy >= 0.93
        print("all hold" if good else "NOT all hold (15 ms, 5 times, 0.93)")
        return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
