"""A sweep under faults at random, by two drivers, beside two readers: nothing lost, nothing twice, nothing grows.

    python -m tests.studies.sweeps.soak [cells=5000] [minutes=20] [seed=...]

Faults: SIGKILL for a driver, for a worker and for the server of method processes; a driver that is stopped for a
while; a disk that is slow, full or failing. Each lasts a few seconds. Then the faults end, and the sweep is run to its
end, with ``retry=failed``: a cell whose process was killed from outside, and again when it was tried anew, is a row
that says so. Its results must be those of an undisturbed sweep; memory and descriptors of readers must not grow.
"""

from __future__ import annotations

import contextlib
import errno
import random
import re
import secrets
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import psutil

from tests.studies.sweeps.common import Journal, environment, finish, report, results, start, stored_cells

DRIVERS, READERS = 2, 2
LONGEST_FAULT_S = 4.0
MOST_GROWTH = 1.2
"""Of a reader's memory, from the middle of the soak to its end."""
READER = """
import sys, time
import psutil
from bench.commands.main import main
own = psutil.Process()
while True:
    assert main([*sys.argv[1:], "dry_run=true"]) == 0
    print("held", own.num_fds(), own.memory_info().rss // 1024, file=sys.stderr, flush=True)
    time.sleep(0.5)
"""
"""Plans the sweep, and so reads the whole store, again and again."""


class Soak:
    """A sweep's folder, its drivers and what was done to them."""

    def __init__(self, folder: Path, sweep: list[str], draw: random.Random) -> None:
        self.folder, self.sweep, self.draw, self.store = folder, sweep, draw, folder / "outputs/rows"
        self.drivers: list[subprocess.Popen[str]] = []
        self.faults: Counter[str] = Counter()
        source, library = Path(__file__).with_name("shim.c"), folder / "shim.so"
        subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-o", library, source, "-ldl"], check=True)
        self.shim = {"LD_PRELOAD": library, "SHIM_CONTROL": folder / "control", "SHIM_FOLDER": self.store}

    def driver(self, *more: str) -> subprocess.Popen[str]:
        """Start a driver of the sweep."""
        return start(self.folder, *self.sweep, *more, **{name: str(value) for name, value in self.shim.items()})

    def disturb(self) -> None:
        """Start again the drivers that have ended, and make one fault, over when this returns."""
        for driver in [driver for driver in self.drivers if driver.poll() is not None]:
            finish(driver)
            self.drivers.remove(driver)
        self.drivers += [self.driver() for _ in range(DRIVERS - len(self.drivers))]
        time.sleep(self.draw.uniform(0.5, 3.0))
        victim = self.draw.choice(self.drivers)
        below = psutil.Process(victim.pid).children(recursive=True) if victim.poll() is None else []
        faults: dict[str, Callable[[], None]] = {
            "driver killed": victim.kill,
            "worker killed": lambda: self._kill([child for child in below if not child.children()]),
            "server killed": lambda: self._kill([child for child in below if child.children()]),
            "driver stopped": lambda: self._stop(victim),
            "disk slow": lambda: self._disk(50, 0),
            "disk full": lambda: self._disk(0, errno.ENOSPC),
            "disk failing": lambda: self._disk(0, errno.EIO),
        }
        name = self.draw.choice(sorted(faults))
        self.faults[name] += 1
        with contextlib.suppress(psutil.Error):
            faults[name]()

    def _kill(self, processes: list[psutil.Process]) -> None:
        if processes:
            self.draw.choice(processes).kill()

    def _stop(self, driver: subprocess.Popen[str]) -> None:
        driver.send_signal(signal.SIGSTOP)
        time.sleep(self.draw.uniform(0.5, LONGEST_FAULT_S))
        driver.send_signal(signal.SIGCONT)

    def _disk(self, delay_ms: int, error: int) -> None:
        (self.folder / "control").write_text(f"{delay_ms} {error}\n")
        time.sleep(self.draw.uniform(0.5, LONGEST_FAULT_S))
        (self.folder / "control").write_text("0 0\n")


def grows(log: Path) -> bool:
    """Decide by its log whether a reader's descriptors or memory grow; one that never read grows, too."""
    held = [tuple(map(int, numbers)) for numbers in re.findall(r"^held (\d+) (\d+)$", log.read_text(), re.MULTILINE)]
    middle = held[len(held) // 2 :]
    return not held or middle[-1][0] > middle[0][0] + 1 or middle[-1][1] > MOST_GROWTH * middle[0][1]


def tracebacks(log: str) -> int:
    """Count a driver's; without those of Python's own server, whose driver was killed while it asked."""
    cut_off = re.findall(r"Traceback(?:(?!Traceback).)*?recvfds\n +raise EOFError\nEOFError", log, re.DOTALL)
    return log.count("Traceback") - len(cut_off)


def soak(cells: int, minutes: float, seed: int) -> int:
    """Run the soak; return the exit status."""
    cells = 4 * -(-cells // 4)
    sweep = [
        "-m", "method=stand_in", "method.seconds=0.005", "snr=40,30,20,10", f"seed=range(0,{cells // 4})",
        "replicates=1", "workers=1",
    ]  # fmt: skip
    print(f"soak: {cells} cells, {minutes:g} minutes of faults, seed={seed}", flush=True)
    with tempfile.TemporaryDirectory() as name:
        plain, folder = Path(name) / "plain", Path(name) / "soaked"
        for place in (plain, folder):
            (place / "outputs/rows").mkdir(parents=True)
        run = Soak(folder, sweep, random.Random(seed))
        journal = Journal(run.store)
        logs = [folder / f"reader{i}.err" for i in range(READERS)]
        command = [sys.executable, "-c", READER, *sweep]
        readers = []
        for log in logs:
            with log.open("w") as errors:
                readers.append(
                    subprocess.Popen(
                        command, cwd=folder, env=environment(folder), stdout=subprocess.DEVNULL, stderr=errors
                    )
                )
        end = time.monotonic() + 60.0 * minutes
        while time.monotonic() < end and len(stored_cells(run.store)) < cells:
            run.disturb()
        print(f"  {len(stored_cells(run.store))} cells under {dict(run.faults)}")
        for driver in run.drivers:
            driver.kill()
            finish(driver)
        planned = finish(start(folder, *sweep, "dry_run=true"))[1]
        failed = set(re.findall(r"^([0-9a-f]{8}) .* failed ", planned, re.MULTILINE))
        status, _ = finish(run.driver("retry=failed"))
        stored = dict(journal.stored())
        rows: list[tuple[str, object, object]] = [
            ("exit status of the last run", status, 0),
            ("cells in the store", len(stored_cells(run.store)), cells),
            ("cells stored more than once", sum(n > 1 + (one[:8] in failed) for one, n in stored.items()), 0),
            ("results of an undisturbed sweep", results(folder, *sweep) == results(plain, *sweep), True),
            ("tracebacks of drivers", tracebacks((folder / "bench.log").read_text()), 0),
            ("readers that failed", sum(reader.poll() is not None for reader in readers), 0),
        ]
        for reader in readers:
            reader.kill()
            reader.wait()
        rows.append(("readers that grew", sum(map(grows, logs)), 0))
        if status := report("soak", rows):
            print((folder / "bench.log").read_text()[-3000:])
        return status


def main() -> int:
    """Read the arguments and run."""
    if shutil.which("cc") is None:
        print("soak: skipped: cc is not installed")
        return 0
    given = dict(argument.partition("=")[::2] for argument in sys.argv[1:])
    seed = int(given.get("seed", secrets.randbelow(10**6)))
    return soak(int(given.get("cells", 5000)), float(given.get("minutes", 20)), seed)


if __name__ == "__main__":
    sys.exit(main())
