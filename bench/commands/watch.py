"""A sweep followed while a run computes it: what is stored, what is under way, how fast, how long it may still take.

Only the store is looked at, so a run on any machine that shares it can be followed, and nothing is asked of the run.
"""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass

from bench.contract.estimate import Status
from bench.engine.plan import State, plan
from bench.engine.progress import duration
from bench.reporting.rounding import number
from bench.reporting.terminal import clipped
from bench.reporting.terminal_tables import described
from bench.store.cell import Cell
from bench.store.locks import under_way
from bench.store.store import Store

WINDOW_S = 300.0
"""The rate is that of the last five minutes."""
MOST_SHOWN = 3
NO_RUN = "no run is at work on it"
OR_STARTING = "(or one has just begun: bounds come before the first cell)"


@dataclass(frozen=True)
class Look:
    """One look at a sweep: cells by state, fits (replicates), and what is known of the time.

    ``running`` are the cells that runs hold, with the seconds since they took each; ``slowest`` stored cells with the
    seconds that their fits took together. ``fits_per_s`` and ``seconds_left`` are NaN where nothing tells them.
    """

    cells: int
    done: int
    failed: int
    left: int
    fits: int
    fits_left: int
    running: tuple[tuple[Cell, float], ...]
    slowest: tuple[tuple[Cell, float], ...]
    fits_per_s: float
    seconds_left: float


def rate(arrivals: Collection[tuple[float, int]], now: float) -> float:
    """Fits a second from pairs of when a cell was stored (s) and how many fits it has, over the last five minutes.

    The first cell of the window only starts the clock: how long it took is not known. NaN where there is no second.
    """
    recent = sorted(one for one in arrivals if now - WINDOW_S <= one[0] <= now)
    if len(recent) < 2 or now <= recent[0][0]:
        return math.nan
    return sum(n for _, n in recent[1:]) / (now - recent[0][0])


def time_left(fits_left: int, fits_per_s: float, work_s: float, running: int) -> float:
    """Seconds that a run may still take: the longer of two estimates, NaN where there is neither, or no run.

    By the rate, all fits taken to be alike; and by the work: ``work_s``, the time that the remaining fits take as
    stored ones of the same methods did (NaN where not known), shared by as many processes as there are cells under way.
    """
    if not fits_left:
        return 0.0
    if not running:
        return math.nan
    by_rate = fits_left / fits_per_s if fits_per_s > 0 else math.nan
    known = [one for one in (by_rate, work_s / running) if not math.isnan(one)]
    return max(known, default=math.nan)


class Progress:
    """Where the cells of a sweep stand, kept up to date by looking at files that have changed only."""

    def __init__(self, cells: Sequence[Cell], store: Store, retry: Collection[Status] = ()) -> None:
        planned = plan(cells, store, retry)
        self.store, self.seconds = store, store.fit_seconds()
        self.cells = {one.cell.identity: one.cell for one in planned}
        self.left = {one.cell.identity: one.stamp for one in planned if one.run}
        self.failed = {one.cell.identity for one in planned if one.state is State.FAILED and not one.run}
        kept = self.cells.keys() - self.left.keys()
        self.arrivals = {identity: store.stamp(identity) / 1e9 for identity in kept if store.own(identity)}
        self.spent = {identity: head.wall_s for identity in kept if (head := store.head(identity))}

    def look(self) -> Look:
        """The sweep as it stands now. Raises InputError where a cell's file is damaged."""
        folder = self.store.folder  # which is not there where all is in the archive
        there = {entry.name for entry in os.scandir(folder)} if folder.is_dir() else set()
        for identity, before in list(self.left.items()):
            if f"{identity}.json" in there and self.store.stamp(identity) != before:
                del self.left[identity]
                self._note(identity)
        now = time.time()
        claims = under_way(self.store.claims)
        running = [(self.cells[name], max(0.0, now - since)) for name, since in claims.items() if name in self.left]
        fits_left = sum(self.cells[name].replicates for name in self.left)
        arrivals = [(when, self.cells[name].replicates) for name, when in self.arrivals.items()]
        fits_per_s = rate(arrivals, now) if running else math.nan
        slowest = sorted(self.spent.items(), key=lambda one: -one[1])[:MOST_SHOWN]
        return Look(
            cells=len(self.cells),
            done=len(self.cells) - len(self.left) - len(self.failed),
            failed=len(self.failed),
            left=len(self.left),
            fits=sum(cell.replicates for cell in self.cells.values()),
            fits_left=fits_left,
            running=tuple(sorted(running, key=lambda one: -one[1])),
            slowest=tuple((self.cells[name], seconds) for name, seconds in slowest),
            fits_per_s=fits_per_s,
            seconds_left=time_left(fits_left, fits_per_s, self._work(), len(running)),
        )

    def _note(self, identity: str) -> None:
        """Read a cell that has been stored."""
        stored, cell = self.store.head(identity), self.cells[identity]
        assert stored is not None  # a cell is replaced in one step, and never taken away
        self.arrivals[identity] = self.store.stamp(identity) / 1e9
        self.spent[identity] = stored.wall_s
        if not stored.statuses.keys() <= {Status.OK, Status.UNSUPPORTED}:
            self.failed.add(identity)
        if stored.wall_s > 0:
            self.seconds.setdefault(cell.label, stored.wall_s / cell.replicates)

    def _work(self) -> float:
        """Seconds that the remaining fits take, one after another; NaN where a method has no stored cell."""
        left = (self.cells[name] for name in self.left)
        return sum(self.seconds.get(cell.label, math.nan) * cell.replicates for cell in left)


def line(look: Look) -> str:
    """A look in one line."""
    text = f"{look.done + look.failed}/{look.cells} cells" + (f", {look.failed} failed" if look.failed else "")
    if not look.left:
        return f"{text}, all stored"
    if not look.running:
        return f"{text}; {NO_RUN}"
    speed = "" if math.isnan(look.fits_per_s) else f"{number(look.fits_per_s)} fits/s, "
    return f"{text}, {len(look.running)} under way, {speed}{left_text(look)}"


def left_text(look: Look) -> str:
    """How long the sweep may still take, in words."""
    if not look.left:
        return "all stored"
    return "time left unknown" if math.isnan(look.seconds_left) else f"about {duration(look.seconds_left)} left"


def block(look: Look) -> list[str]:
    """A look in a few lines, none longer than the terminal is wide."""
    missing = f", {look.left - len(look.running)} to come" if look.left > len(look.running) else ""
    lines = [
        f"cells  {look.done} done, {look.failed} failed, {len(look.running)} under way{missing}; {look.cells} in all",
        f"fits   {look.fits - look.fits_left} of {look.fits}"
        + ("" if math.isnan(look.fits_per_s) else f", {number(look.fits_per_s)} a second")
        + f"; {left_text(look)}",
    ]
    if look.left and not look.running:
        lines += [NO_RUN, OR_STARTING]
    lines += [f"now    {name(cell)}, for {duration(seconds)}" for cell, seconds in look.running[:MOST_SHOWN]]
    lines += [
        f"slow   {name(cell)}, {duration(seconds)} for its {cell.replicates} fits" for cell, seconds in look.slowest
    ]
    return [clipped(text) for text in lines]


def name(cell: Cell) -> str:
    """A cell in a few words."""
    return f"{cell.label} on {described(cell.scenario)}"


def follow(progress: Progress, seconds: float) -> None:
    """Show a sweep until all of its cells are stored: in place on a terminal, else a line a look."""
    in_place = sys.stdout.isatty() and os.environ.get("TERM", "dumb") != "dumb"
    shown = 0
    while True:
        started = time.monotonic()
        look = progress.look()
        if in_place:
            lines = [*block(look), "Ctrl-C ends the watch, not the run" if look.left else ""]
            up = f"\x1b[{shown}F\x1b[J" if shown else ""
            sys.stdout.write(up + "\n".join(lines).rstrip("\n") + "\n")
            shown = len("\n".join(lines).rstrip("\n").splitlines())
        else:
            print(clipped(f"{time.strftime('%H:%M:%S')} {line(look)}"))
        sys.stdout.flush()
        if not look.left:
            return
        took = time.monotonic() - started
        time.sleep(max(seconds, 20.0 * took))  # where looking takes long, a twentieth of the time goes into it
