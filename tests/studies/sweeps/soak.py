"""A sweep under faults at random, by two drivers, beside four readers: nothing lost, nothing twice, nothing grows.

    python -m tests.studies.sweeps.soak [cells=5000] [minutes=20] [seed=...]

Faults: SIGKILL for a driver, for a worker and for the server of method processes; a driver that is stopped for a
while; a disk that is slow, full or failing (:mod:`tests.studies.sweeps.shim`); a clock that jumps. Each lasts a few
seconds. Then the faults end, and the sweep is run to its end, with ``retry=failed``: a cell whose process was killed
from outside, and again when it was tried anew, is a row that says so. Every cell must have been stored once, and no
reader may have failed; the tables must be those of an undisturbed sweep; memory and descriptors of readers must not
grow.
"""

from __future__ import annotations

import contextlib
import errno
import os
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
from dataclasses import dataclass, field
from pathlib import Path

import psutil

from bench.store.store import ABANDONED_S, Store
from tests.studies.sweeps.common import cell_files, csv, environment, report
from tests.studies.sweeps.journal import Journal
from tests.studies.sweeps.shim import Shim, why_not

DRIVERS, READERS = 2, 4
METHOD_SECONDS = 0.005
LONGEST_FAULT_S = 4.0
READER = """
import sys, time
from pathlib import Path
import psutil
from bench.contract.estimate import Status
from bench.store.store import ABANDONED_S, Store
own, store, rounds = psutil.Process(), Store(Path(sys.argv[1])), 0
while True:
    found = sum(not head.problem for head in store.heads())
    rounds += 1
    print(rounds, found, own.num_fds(), own.memory_info().rss // 1024, flush=True)
    time.sleep(0.5)
"""
"""Reads the whole store again and again: a line a round, of cells, descriptors and memory (KiB)."""
REST_S = 30.0
"""Readers go on so long when all cells are there: what they hold of a cell grows no more."""
MOST_GROWTH = 1.1
"""Of a reader's memory in that time, from the first third to the last."""


@dataclass
class Soak:
    """A sweep's folder, its drivers and what was done to them."""

    folder: Path
    sweep: list[str]
    shim: Shim
    draw: random.Random
    drivers: dict[int, subprocess.Popen[bytes]] = field(default_factory=dict)
    faults: Counter[str] = field(default_factory=Counter)
    statuses: Counter[int] = field(default_factory=Counter)
    descriptors: int = 0

    @property
    def store(self) -> Path:
        return self.folder / "outputs/rows"

    def keep_drivers(self) -> None:
        """Start again each driver that has ended."""
        for place in range(DRIVERS):
            process = self.drivers.get(place)
            if process is not None and process.poll() is None:
                self.descriptors = max(self.descriptors, _descriptors(process.pid))
                continue
            if process is not None:
                self.statuses[process.returncode] += 1
            self.drivers[place] = self.start(place)

    def start(self, place: int, *more: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "bench", *self.sweep, *more]
        around = environment(self.folder) | self.shim.environment()
        with (self.folder / f"driver{place}.log").open("ab") as log:
            return subprocess.Popen(command, cwd=self.folder, env=around, stdout=log, stderr=log)

    def fault(self) -> None:
        """One fault, over when this returns."""
        kinds: dict[str, Callable[[], None]] = {
            "driver killed": lambda: self._kill("driver"),
            "worker killed": lambda: self._kill("worker"),
            "server killed": lambda: self._kill("server"),
            "driver stopped": self._stop,
            "disk slow": lambda: self._disk(50, 0),
            "disk full": lambda: self._disk(0, errno.ENOSPC),
            "disk failing": lambda: self._disk(0, errno.EIO),
        }
        if self.shim.clock_jumps:
            kinds["clock jumps"] = self._jump
        name = self.draw.choice(sorted(kinds))
        self.faults[name] += 1
        kinds[name]()

    def _kill(self, what: str) -> None:
        place = self.draw.randrange(DRIVERS)
        driver = self.drivers[place]
        if what == "driver":
            driver.kill()
            return
        servers, workers = _children(driver.pid)
        victims = servers if what == "server" else workers
        if victims:
            _signal(self.draw.choice(victims), signal.SIGKILL)

    def _stop(self) -> None:
        pid = self.drivers[self.draw.randrange(DRIVERS)].pid
        _signal(pid, signal.SIGSTOP)
        time.sleep(self.draw.uniform(0.5, LONGEST_FAULT_S))
        _signal(pid, signal.SIGCONT)

    def _disk(self, delay_ms: int, error: int) -> None:
        self.shim.disk(delay_ms, error)
        time.sleep(self.draw.uniform(0.5, LONGEST_FAULT_S))
        self.shim.disk()

    def _jump(self) -> None:
        self.shim.clock(self.draw.choice([-86400, -60, 60, 86400]))
        time.sleep(self.draw.uniform(0.5, LONGEST_FAULT_S))


def _signal(pid: int, number: signal.Signals) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, number)


def _descriptors(pid: int) -> int:
    try:
        return psutil.Process(pid).num_fds()
    except psutil.Error:
        return 0


def _children(pid: int) -> tuple[list[int], list[int]]:
    """Servers (children that have children) and workers (leaves) of a driver."""
    servers: list[int] = []
    workers: list[int] = []
    with contextlib.suppress(psutil.Error):
        for child in psutil.Process(pid).children(recursive=True):
            (servers if child.children() else workers).append(child.pid)
    return servers, workers


@dataclass
class Reader:
    """A process that reads the store over and over, and its log."""

    process: subprocess.Popen[bytes]
    log: Path

    @staticmethod
    def started(folder: Path, store: Path, place: int) -> Reader:
        log = folder / f"reader{place}.log"
        with log.open("wb") as out:
            command = [sys.executable, "-c", READER, str(store)]
            return Reader(subprocess.Popen(command, env=environment(folder), stdout=out, stderr=out), log)

    def ended(self) -> tuple[bool, list[tuple[int, int, int]]]:
        """Whether it was still running, and of every round the cells, descriptors and memory (KiB)."""
        alive = self.process.poll() is None
        self.process.kill()
        self.process.wait()
        lines = [line.split() for line in self.log.read_text(errors="replace").splitlines()]
        good = [tuple(map(int, line[1:])) for line in lines if len(line) == 4 and all(p.isdecimal() for p in line)]
        return alive, [(one[0], one[1], one[2]) for one in good]


def _flat(rounds: list[tuple[int, int, int]]) -> bool:
    """Whether descriptors stay throughout, and memory once all cells are there."""
    rest = [one for one in rounds if one[0] == rounds[-1][0]]
    part = max(1, len(rest) // 3)
    kib = [max(one[2] for one in some) for some in (rest[:part], rest[-part:])]
    handles = [max(one[1] for one in some) for some in (rounds[: len(rounds) // 2 + 1], rounds[len(rounds) // 2 :])]
    return handles[1] <= handles[0] + 1 and kib[1] <= MOST_GROWTH * kib[0]


def failures(store: Path) -> set[str]:
    """The stored cells with a replicate that failed."""
    return {
        cell.identity
        for cell in Store(store)
        if cell.columns.statuses and any(s != "ok" for s in cell.columns.statuses)
    }


def left_over(store: Path) -> int:
    """The temporary files that a run leaves lying an hour or more after their writer was killed."""
    for path in store.glob("*.tmp"):
        os.utime(path, (time.time() - 2 * ABANDONED_S,) * 2)
    Store(store).prepare()
    return len(list(store.glob("*.tmp")))


def tracebacks(log: str) -> int:
    """How many a driver has shown; without those of Python's own server, whose driver was killed while it asked."""
    cut_off = re.findall(r"Traceback(?:(?!Traceback).)*?recvfds\n +raise EOFError\nEOFError", log, re.S)
    return log.count("Traceback") - len(cut_off)


def soak(cells: int, minutes: float, seed: int) -> int:
    """Run it; the exit status."""
    draw, seeds = random.Random(seed), -(-cells // 4)
    cells = 4 * seeds
    sweep = [
        "-m", "method=busy", f"method.seconds={METHOD_SECONDS}", "snr=40,30,20,10", f"seed=range(0,{seeds})",
        "replicates=1", "workers=1",
    ]  # fmt: skip
    print(f"soak: {cells} cells, {minutes:g} minutes of faults, seed={seed}", flush=True)
    with tempfile.TemporaryDirectory() as name:
        plain, folder = Path(name) / "plain", Path(name) / "soaked"
        for one in (plain, folder):
            (one / "outputs/rows").mkdir(parents=True)
        run = Soak(folder, sweep, Shim.made(folder, folder / "outputs/rows"), draw)
        journal = Journal(run.store)
        readers = [Reader.started(folder, run.store, place) for place in range(READERS)]
        end = time.monotonic() + 60.0 * minutes
        while time.monotonic() < end and len(cell_files(run.store)) < cells:
            run.keep_drivers()
            time.sleep(draw.uniform(0.5, 3.0))
            run.fault()
        run.shim.clock(0)
        under_faults = len(cell_files(run.store))
        for driver in run.drivers.values():
            driver.kill()
            driver.wait()
        failed = failures(run.store)
        last = run.start(0, "retry=failed").wait()
        stored = journal.stored()
        time.sleep(REST_S)
        read = [reader.ended() for reader in readers]
        logs = [path.read_text(errors="replace") for path in folder.glob("driver*.log")]
        undisturbed = subprocess.run(
            [sys.executable, "-m", "bench", *sweep], cwd=plain, env=environment(plain), capture_output=True
        ).returncode
        print(f"  faults: {', '.join(f'{n} x {what}' for what, n in sorted(run.faults.items()))}")
        print(f"  drivers ended with {dict(run.statuses)}; at most {run.descriptors} descriptors in one")
        print(f"  readers hold at most {max(kib for _, rounds in read for *_, kib in rounds) / 1024:.0f} MiB")
        print(f"  {under_faults} cells were stored while faults were injected, {len(failed)} of them as failures")
        rows: list[tuple[str, object, object]] = [
            ("exit status of the undisturbed sweep", undisturbed, 0),
            ("exit status of the last run", last, 0),
            ("cells in the store", len(cell_files(run.store)), cells),
            ("cells stored more than once", sum(n > 1 + (name in failed) for name, n in stored.items()), 0),
            ("the same cells as undisturbed", cell_files(run.store) == cell_files(plain / "outputs/rows"), True),
            ("tables of every metric identical", csv(run.store) == csv(plain / "outputs/rows"), True),
            ("tracebacks of drivers", sum(tracebacks(text) for text in logs), 0),
            ("readers that failed", sum(not alive for alive, _ in read), 0),
            ("readers that grew", sum(not (rounds and _flat(rounds)) for _, rounds in read), 0),
            ("temporary files of writers that were killed, when the next run comes", left_over(run.store), 0),
        ]
        status = report("soak", rows)
        if status:
            kept = Path(tempfile.mkdtemp(prefix="soak-"))
            for path in folder.glob("*.log"):
                shutil.copy(path, kept)
            print(f"  logs: {kept}")
        return status


def main() -> int:
    """Read the arguments and run."""
    if reason := why_not():
        print(f"soak: skipped: {reason}")
        return 0
    given = dict(argument.partition("=")[::2] for argument in sys.argv[1:])
    seed = int(given.get("seed", secrets.randbelow(10**6)))
    return soak(int(given.get("cells", 5000)), float(given.get("minutes", 20)), seed)


if __name__ == "__main__":
    sys.exit(main())
