"""A sweep under faults at random, by two drivers: nothing lost, nothing twice.

    python -m tests.studies.sweeps.soak [cells=5000] [minutes=20] [seed=...]

Faults: SIGKILL for a driver, for a worker and for the server of method processes; a driver that is stopped for a
while; a disk that is slow, full or failing. Each lasts a few seconds. Then the faults end, and the sweep is run to its
end, with ``retry=failed``: a cell whose process was killed from outside, and again when it was tried anew, is a row
that says so. Its results must be those of an undisturbed sweep.
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
from typing import Annotated

import psutil

from bench.commands.declaration import Within
from tests.studies.common import Count, study
from tests.studies.sweeps.common import Journal, finish, report, results, start, stored_cells

DRIVERS = 2
LONGEST_FAULT_S = 4.0


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


def soak(
    cells: Annotated[Count, "cells of the sweep"] = 5000,
    minutes: Annotated[float, Within(gt=0.0), "time of faults, at most"] = 20.0,
    seed: Annotated[int | None, "of the faults; empty: drawn"] = None,
) -> int:
    """Run a sweep under faults, then to its end, and compare it with an undisturbed one."""
    if shutil.which("cc") is None:
        print("soak: skipped: cc is not installed")
        return 0
    cells, seed = 4 * -(-cells // 4), secrets.randbelow(10**6) if seed is None else seed
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
        log = (folder / "bench.log").read_text()
        # without those of Python's own server and of a process that it starts, whose driver was killed while it asked
        cut_off = re.findall(
            r"Traceback[^\n]*\n[^\n]*forkserver\.py(?:(?!Traceback).)*?\n(?:EOFError|\S*Unpickl)", log, re.DOTALL
        )
        rows: list[tuple[str, object, object]] = [
            ("exit status of the last run", status, 0),
            ("cells in the store", len(stored_cells(run.store)), cells),
            ("cells stored more than once", sum(n > 1 + (name[:8] in failed) for name, n in stored.items()), 0),
            ("results of an undisturbed sweep", results(folder, *sweep) == results(plain, *sweep), True),
            ("tracebacks of drivers", log.count("Traceback") - len(cut_off), 0),
        ]
        if status := report("soak", rows):
            print(log[-3000:])
        return status


if __name__ == "__main__":
    sys.exit(study(soak, "tests.studies.sweeps.soak"))
