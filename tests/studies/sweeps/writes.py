"""``python -m tests.studies.sweeps.writes``: workers killed while they write, a full disk, two drivers on one store.

Nothing that was reported done may be lost, nothing torn, nothing there twice. About 2 minutes; the full disk is a small
tmpfs, for which the script needs to be allowed to mount one (it says so where it is not).
"""

from __future__ import annotations

import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil

from bench.store.store import Store
from tests.studies.sweeps.common import bench, cell_files, csv, finish, report

KILLS = 20
SWEEP = ("-m", "method=empty", "snr=40,30,20,10", "seed=range(0,60)", "replicates=3", "workers=2")
CELLS = 240


def whole(folder: Path) -> int:
    """How many stored cells can be read; raises what a torn one would."""
    return sum(1 for _ in Store(folder))


def kill_workers(driver: subprocess.Popen[str], kills: int, draw: random.Random) -> int:
    """Kill random children of a sweep, at random moments, but not the server that starts them; how many."""
    done = 0
    while driver.poll() is None and done < kills:
        time.sleep(0.05 + 0.2 * draw.random())
        try:
            servers = psutil.Process(driver.pid).children()
            workers = [child for server in servers for child in server.children()]
            if workers:
                draw.choice(workers).send_signal(signal.SIGKILL)
                done += 1
        except psutil.Error:
            continue
    return done


def killed(folder: Path) -> list[tuple[str, object, object]]:
    """Twenty kills among the processes that fit, score and write; those that hit a fit are rows, and tried again."""
    folder.mkdir()
    process = bench(folder, *SWEEP)
    reader = threading.Thread(target=process.communicate)
    reader.start()
    done = kill_workers(process, KILLS, random.Random(1))
    reader.join()
    store = folder / "outputs/rows"
    first = len(cell_files(store))
    again, _ = finish(bench(folder, *SWEEP, "retry=failed"))
    good = sum(cell.n_ok == 3 for cell in Store(store))
    return [
        ("workers killed", done, KILLS),
        ("cells after the kills", first, CELLS),
        ("exit status of the retry", again, 0),
        ("cells that can be read", whole(store), CELLS),
        ("cells with all replicates good after the retry", good, CELLS),
    ]


@contextmanager
def tmpfs(folder: Path, size: str) -> Iterator[bool]:
    """A small file system in memory; False where mounting is not allowed."""
    folder.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", folder], capture_output=True)
    try:
        yield mounted.returncode == 0
    finally:
        if mounted.returncode == 0:
            subprocess.run(["umount", "-l", folder], check=True)


def full(folder: Path, reference: Path) -> list[tuple[str, object, object]]:
    """The sweep on a disk that is full after some dozen cells, and again once there is room."""
    folder.mkdir()
    with tmpfs(folder / "small", "1m") as mounted:
        if not mounted:
            print("  skipped: a full disk (no right to mount a tmpfs)")
            return []
        store = folder / "small/rows"
        status, _ = finish(bench(folder, *SWEEP, f"store={store}"))
        lines = [line for line in (folder / "bench.log").read_text().splitlines() if line.startswith("bench: store=")]
        kept = whole(store)
        subprocess.run(["mount", "-o", "remount,size=200m", folder / "small"], check=True)
        again, _ = finish(bench(folder, *SWEEP, f"store={store}"))
        return [
            ("exit status on the full disk", status, 2),
            ("one line that says so", len(lines) == 1 and "No space left" in lines[0], True),
            ("cells kept, all whole", 0 < kept < CELLS, True),
            ("exit status once there is room", again, 0),
            ("cells then", whole(store), CELLS),
            ("table as of an undisturbed run", csv(store) == csv(reference), True),
        ]


def shared(folder: Path, reference: Path) -> list[tuple[str, object, object]]:
    """Two drivers started together on one store."""
    folder.mkdir()
    drivers = [bench(folder, *SWEEP, log=f"{i}.log") for i in range(2)]
    results = [finish(driver) for driver in drivers]
    store = folder / "outputs/rows"
    return [
        ("exit status of both", [status for status, _ in results], [0, 0]),
        ("both print the same table", results[0][1] == results[1][1], True),
        ("cells", whole(store), CELLS),
        ("table as of one driver", csv(store) == csv(reference), True),
        ("claims left", len(list((store / "claims").iterdir())), 0),
    ]


def main() -> int:
    """Print what held; exit status 1 where something did not."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "plain").mkdir()
        finish(bench(folder / "plain", *SWEEP))
        reference = folder / "plain/outputs/rows"
        parts = {
            f"{KILLS} workers killed (-9)": killed(folder / "killed"),
            "a full disk": full(folder / "full", reference),
            "two drivers on one store": shared(folder / "shared", reference),
        }
        return max(report(title, rows) for title, rows in parts.items())


if __name__ == "__main__":
    sys.exit(main())
