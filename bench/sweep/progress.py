"""How far a run is, and how long it may still take by what its own work has taken so far.

Methods differ in cost by a factor of thousands, so time is measured by kind of work: a method on a system. What a cell
costs before its first fit (a process, imported packages) is kept apart from the fits. The first cell of every kind runs
first, so that little is unknown for long; what is unknown is not guessed: the time left is then said to be a least one.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import fmean
from typing import TypeVar

import numpy as np

from bench.scoring.row import Row
from bench.store.cell import Cell
from bench.sweep.plan import FAILURES

T = TypeVar("T")
Kind = tuple[str, str]
"""A method and a system, by their labels."""


@dataclass(frozen=True)
class Look:
    """Where a run stands.

    Attributes:
        unit: What is counted: ``bound`` or ``fit``.
        done: How many of these.
        total: Of how many.
        what: What the last one was of.
        seconds_left: What the rest takes whose cost is known; NaN where none is.
        at_least: Whether there is some of which nothing is known yet.
        cells_done: Cells whose fits are all there.
        cells: All of them; 0 while bounds are made.
        failed: Fits so far that failed.
    """

    unit: str
    done: int
    total: int
    what: str
    seconds_left: float
    at_least: bool
    cells_done: int = 0
    cells: int = 0
    failed: int = 0


OnLook = Callable[[Look], None]
"""Is called whenever some of the work is done, and before the first."""


@dataclass(frozen=True)
class Fitted:
    """Work that is done on a cell.

    Attributes:
        cell: The cell.
        n: So many of its fits are no longer to be done.
        rows: What came out, where it was computed here.
        seconds: That a worker needed, all in all; NaN where it was not computed here.
        first: Whether a process began the cell with it.
    """

    cell: Cell
    n: int
    rows: Sequence[Row] = ()
    seconds: float = math.nan
    first: bool = False


@dataclass
class Mean:
    """A mean that grows: ``each`` is NaN before the first value."""

    total: float = 0.0
    n: int = 0

    def add(self, seconds: float, n: int = 1) -> None:
        self.total, self.n = self.total + seconds, self.n + n

    @property
    def each(self) -> float:
        return self.total / self.n if self.n else math.nan


class Costs:
    """Seconds of work by kind, as measured; a kind that was not measured costs what its method does elsewhere."""

    def __init__(self) -> None:
        self._means: dict[Hashable, Mean] = defaultdict(Mean)

    def add(self, kind: Kind, seconds: float, n: int = 1) -> None:
        """Note what ``n`` pieces of work of a kind took."""
        for key in (kind, kind[0]):
            self._means[key].add(seconds, n)

    def each(self, kind: Kind) -> float:
        """Seconds of one piece; NaN where nothing is known."""
        known = self._means.get(kind) or self._means.get(kind[0])
        return known.each if known else math.nan


def kind_of(cell: Cell) -> Kind:
    """The kind of a cell's fits."""
    return cell.label, cell.scenario.label


@dataclass
class FitsProgress:
    """The fits of a run, on ``workers`` processes.

    Attributes:
        left: Fits to be done, by cell.
        kinds: The kind of each cell.
        together: How many fits of a kind are one task, which one process does.
        workers: How many processes fit.
    """

    left: Mapping[str, int]
    kinds: Mapping[str, Kind]
    together: Mapping[Kind, int]
    workers: int
    _starts: Costs = field(default_factory=Costs)
    _fits: Costs = field(default_factory=Costs)
    _cells_done: int = 0
    _failed: int = 0

    def __post_init__(self) -> None:
        self._open = dict(self.left)
        self._begun: set[str] = set()
        self._fits_left, self._cells_left = Counter[Kind](), Counter[Kind]()
        for identity, n in self._open.items():
            self._fits_left[self.kinds[identity]] += n
            self._cells_left[self.kinds[identity]] += bool(n)
        self._total = sum(self._open.values())

    def begin(self) -> Look:
        """Before the first fit."""
        return self._look("")

    def fitted(self, done: Fitted) -> Look:
        """Note what was done."""
        identity, kind = done.cell.identity, self.kinds[done.cell.identity]
        if identity not in self._begun:
            self._begun.add(identity)
            self._cells_left[kind] -= bool(self._open[identity])
        self._open[identity] -= done.n
        self._fits_left[kind] -= done.n
        self._cells_done += self._open[identity] == 0
        self._failed += sum(row.status in FAILURES for row in done.rows)
        if math.isfinite(done.seconds):
            self._measure(kind, done)
        return self._look(f"{done.cell.label} {done.cell.scenario.snr_db:g} dB")

    def _measure(self, kind: Kind, done: Fitted) -> None:
        """Of the first task of a cell, what is not fitting is the cost of its start."""
        fitting = min(float(np.nansum([row.wall_s for row in done.rows])), done.seconds)
        if done.first:
            self._starts.add(kind, done.seconds - fitting)
        self._fits.add(kind, fitting if done.first else done.seconds, done.n)

    def _look(self, what: str) -> Look:
        known, longest, unknown = 0.0, 0.0, False
        for kind, n in self._fits_left.items():
            each, start = self._fits.each(kind), self._starts.each(kind)
            if not n:
                continue
            if math.isnan(each):
                unknown = True
                continue
            known += n * each + self._cells_left[kind] * (0.0 if math.isnan(start) else start)
            longest = max(longest, min(n, self.together[kind]) * each)
        done = self._total - sum(self._fits_left.values())
        return Look(
            unit="fit",
            done=done,
            total=self._total,
            what=what,
            seconds_left=math.nan if unknown and not known else max(known / self.workers, longest),
            at_least=unknown,
            cells_done=self._cells_done,
            cells=len(self._open),
            failed=self._failed,
        )


class BoundsProgress:
    """The bounds that a run makes, one after another; ``systems`` are the labels of their systems, in order.

    The first bound of a system is no example for the others, since much is compiled for it.
    """

    def __init__(self, systems: Sequence[str]) -> None:
        self._systems, self._done = list(systems), 0
        self._took: dict[str, list[float]] = defaultdict(list)

    def begin(self) -> Look:
        """Before the first bound."""
        return self._look("")

    def made(self, seconds: float) -> Look:
        """Note that the next bound is there, or known to be impossible."""
        system = self._systems[self._done]
        self._took[system].append(seconds)
        self._done += 1
        return self._look(system)

    def _look(self, what: str) -> Look:
        left = self._systems[self._done :]
        known = [fmean(took[1:] or took) for system in left if (took := self._took.get(system))]
        seconds = sum(known) if known or not left else math.nan
        return Look("bound", self._done, len(self._systems), what, seconds, len(known) < len(left))


def firsts_first(items: Sequence[T], kind: Callable[[T], Hashable]) -> list[T]:
    """The items in their order, but for the first of every kind: these come first, and tell what the others cost."""
    first: dict[Hashable, int] = {}
    for i, item in enumerate(items):
        first.setdefault(kind(item), i)
    early = sorted(first.values())
    chosen = set(early)
    return [items[i] for i in early] + [item for i, item in enumerate(items) if i not in chosen]


def duration(seconds: float) -> str:
    """A time in the unit that suits it."""
    for size, unit in ((86400.0, "d"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 1.5 * size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.0f} s"
