"""``python -m tests.studies.sweeps.kills``: 200 cells, the driver killed (-9) at ten random moments, rerun each time.

Every cell must be there once, and the tables must be those of an uninterrupted run, byte for byte. About 2 minutes.
"""

from __future__ import annotations

import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.studies.sweeps.common import bench, cell_files, csv, finish, report

KILLS = 10
SWEEP = (
    "-m", "method=busy", "method.seconds=0.05", "snr=40,30,20,10", "seed=range(0,50)", "replicates=2", "workers=2",
)  # fmt: skip


def survivors() -> int:
    """Processes of ours that outlived their driver."""
    listed = subprocess.run(["ps", "ax", "-o", "args"], capture_output=True, text=True).stdout
    return sum("multiprocessing.forkserver" in line for line in listed.splitlines())


def main() -> int:
    """Print what held; exit status 1 where something did not."""
    draw = random.Random(int(sys.argv[1]) if len(sys.argv) > 1 else 0)
    with tempfile.TemporaryDirectory() as name:
        plain, killed = Path(name) / "plain", Path(name) / "killed"
        for folder in (plain, killed):
            folder.mkdir()
        before = survivors()
        started = time.monotonic()
        status, table = finish(bench(plain, *SWEEP))
        whole = time.monotonic() - started
        shutil.copytree(plain / "outputs/rows/bounds", killed / "outputs/rows/bounds")
        stored = []
        for i in range(KILLS):
            process = bench(killed, *SWEEP)
            time.sleep(2.0 + draw.random() * 0.15 * whole)
            process.send_signal(signal.SIGKILL)
            process.wait()
            stored.append(len(cell_files(killed / "outputs/rows")))
            print(f"  kill {i + 1}: {stored[-1]} cells stored")
        time.sleep(1.0)
        left = survivors() - before
        again, table_again = finish(bench(killed, *SWEEP))
        rows = [
            ("exit status of the uninterrupted run", status, 0),
            ("exit status of the last rerun", again, 0),
            ("cells of the uninterrupted run", len(cell_files(plain / "outputs/rows")), 200),
            ("cells of the killed runs", len(cell_files(killed / "outputs/rows")), 200),
            ("same cells", cell_files(plain / "outputs/rows") == cell_files(killed / "outputs/rows"), True),
            ("none lost between kills", stored == sorted(stored), True),
            ("kills that hit a run under way", sum(n < 200 for n in stored) >= 5, True),
            ("temporary files left", len(list((killed / "outputs/rows").glob("*.tmp"))) <= 2 * KILLS, True),
            ("processes left behind", left, 0),
            ("printed tables identical", table == table_again, True),
            ("tables of every metric identical", csv(plain / "outputs/rows") == csv(killed / "outputs/rows"), True),
        ]
        return report(f"200 cells, driver killed {KILLS} times", rows)


if __name__ == "__main__":
    sys.exit(main())
