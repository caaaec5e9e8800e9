"""Progress of a run: how much is done, and how long the rest takes by what the work has cost so far.

Methods differ in cost by a factor of thousands, so costs are averaged by kind of work, e.g. a method on a system. The
first task of every kind runs first. The time of work of unknown cost is not guessed: the time left is then displayed
as a lower limit.
"""

from __future__ import annotations

import logging
import math
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

T = TypeVar("T")
Kind = tuple[str, str]
"""Two labels, e.g. of a method and a system: where the cost of the pair is unknown, that of the first is taken."""
LINE_S = 30.0
"""Interval of the lines that replace a bar where the error stream is no terminal (s)."""
DRAWS_PER_S = 2


@dataclass(frozen=True)
class RunState:
    """The state of a run.

    Attributes:
        unit: Name of what is counted, e.g. ``bound`` or ``fit``.
        done: Number of finished units.
        total: Number of all units.
        what: Name of the unit that was finished last.
        seconds_left: Time that the remaining units of known cost take (s); NaN where no cost is known.
        at_least: Whether the cost of some remaining units is unknown.
        note: Further counts to be displayed, e.g. ``2/8 cells, 1 failed``.
    """

    unit: str
    done: int
    total: int
    what: str = ""
    seconds_left: float = math.nan
    at_least: bool = True
    note: str = ""

    def words(self, since: float, elapsed: float) -> str:
        """Describe the state, the time left first, ``since`` seconds after it was reported."""
        over = self.done == self.total
        counts = [self.note, f"{self.done}/{self.total} {self.unit}s"]
        if over:
            parts = [*counts, f"in {duration(elapsed)}"]
        else:
            parts = [self._left(since), *counts, f"{duration(elapsed)} so far", self.what]
        return ", ".join(filter(None, parts))

    def _left(self, since: float) -> str:
        left = self.seconds_left - since
        if math.isnan(left) or (left < 0 and self.at_least):
            return "time left not known yet"
        return (
            f"{'at least' if self.at_least else 'about'} {duration(left)} left" if left >= 0 else "longer than expected"
        )


OnProgress = Callable[[RunState], None]
"""A function that is called once before the work and after each part of it."""


class Progress:
    """The progress of tasks of several parts each, performed by ``workers`` processes.

    ``sizes`` and ``kinds`` give the number of parts and the kind of each task. Tasks are counted by the name ``task``
    unless it is empty.
    """

    def __init__(
        self, unit: str, sizes: Mapping[str, int], kinds: Mapping[str, Kind], workers: int = 1, task: str = ""
    ) -> None:
        self.unit, self.workers, self.task = unit, workers, task
        self._open, self._kinds, self._total = dict(sizes), kinds, sum(sizes.values())
        self._left = Counter[Kind]()
        for key, n in sizes.items():
            self._left[kinds[key]] += n
        self._first: dict[Hashable, tuple[float, int]] = {}
        self._seconds: dict[Hashable, float] = defaultdict(float)
        self._pieces = Counter[Hashable]()
        self._failed = 0

    def add(self, key: str, n: int, seconds: float = math.nan, failed: int = 0, what: str = "") -> RunState:
        """Count ``n`` finished parts of a task, of which ``failed`` failed.

        ``seconds`` is the time that they took one worker, NaN where they were not computed in this run.
        """
        kind = self._kinds[key]
        self._open[key] -= n
        self._left[kind] -= n
        self._failed += failed
        if n and math.isfinite(seconds):
            for label in (kind, kind[0]):
                self._first.setdefault(label, (seconds, n))
                self._seconds[label] += seconds
                self._pieces[label] += n
        return self.state(what)

    def state(self, what: str = "") -> RunState:
        """Return the state."""
        costs = {kind: self._cost(kind) for kind, n in self._left.items() if n}
        known = sum(self._left[kind] * cost for kind, cost in costs.items() if not math.isnan(cost))
        unknown = any(map(math.isnan, costs.values()))
        done = sum(not n for n in self._open.values())
        notes = [f"{done}/{len(self._open)} {self.task}s"] if self.task else []
        return RunState(
            unit=self.unit,
            done=self._total - sum(self._left.values()),
            total=self._total,
            what=what,
            seconds_left=math.nan if unknown and not known else known / self.workers,
            at_least=unknown,
            note=", ".join([*notes, *([f"{self._failed} failed"] if self._failed else [])]),
        )

    def _cost(self, kind: Kind) -> float:
        """Return the mean cost of a part (s), without the first, which includes imports, unless it is the only one."""
        label: Hashable = kind if kind in self._first else kind[0]
        if label not in self._first:
            return math.nan
        seconds, n = self._first[label]
        later = self._pieces[label] - n
        return (self._seconds[label] - seconds) / later if later else seconds / n


def first_of_each_kind_first(items: Sequence[T], kind: Callable[[T], Hashable]) -> list[T]:
    """Move the first item of every kind, which measures the cost of its kind, before all others."""
    first = {kind(item): i for i, item in reversed(list(enumerate(items)))}
    return [items[i] for i in sorted(range(len(items)), key=lambda i: (first[kind(items[i])] != i, i))]


def duration(seconds: float) -> str:
    """Format a time in the unit that suits it."""
    for size, unit in ((86400.0, "d"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 1.5 * size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.0f} s"


class _Stage:
    """The last reported state of a unit, and when it and the first were reported."""

    def __init__(self, state: RunState) -> None:
        self.state = state
        self.started = self.reported = self.printed = time.monotonic()
        self.bar: Any = None

    def words(self) -> str:
        now = time.monotonic()
        return self.state.words(now - self.reported, now - self.started)


@contextmanager
def progress_bar(shown: bool = True) -> Iterator[OnProgress]:
    """Show the progress of a run on the error stream: one bar per unit in a terminal, else a line now and then.

    Nothing is shown where the level of the logger ``bench`` leaves warnings out (``-q``).
    """
    if not shown or not logging.getLogger("bench").isEnabledFor(logging.WARNING):
        yield lambda state: None
    elif sys.stderr.isatty():
        with _bars() as on_progress:
            yield on_progress
    else:
        yield _lines()


@contextmanager
def counter(unit: str, total: int) -> Iterator[Callable[..., None]]:
    """Show the progress of work of one kind; yields a function that counts ``n`` (default 1) finished units."""
    progress, started = Progress(unit, {"": total}, {"": ("", "")}), time.monotonic()
    with progress_bar() as on_progress:

        def advance(n: int = 1, what: str = "") -> None:
            nonlocal started
            now = time.monotonic()
            on_progress(progress.add("", n, now - started, what=what))
            started = now

        on_progress(progress.state())
        yield advance


def _lines() -> OnProgress:
    stages: dict[str, _Stage] = {}

    def on_progress(state: RunState) -> None:
        if state.unit in stages and state.done == state.total == stages[state.unit].state.done:
            return  # its last line has been printed
        stage = stages.setdefault(state.unit, _Stage(state))
        stage.state, stage.reported = state, time.monotonic()
        if state.total and (state.done == state.total or stage.reported - stage.printed >= LINE_S):
            stage.printed = stage.reported
            print(f"bench: {state.unit}s {100 * state.done // state.total} %, {stage.words()}", file=sys.stderr)

    return on_progress


@contextmanager
def _bars() -> Iterator[OnProgress]:
    from rich.console import Console
    from rich.progress import BarColumn, ProgressColumn, TextColumn
    from rich.progress import Progress as Bars
    from rich.table import Column
    from rich.text import Text

    class Words(ProgressColumn):
        def render(self, task: Any) -> Text:
            return Text(task.fields["stage"].words(), no_wrap=True, overflow="ellipsis")

    words = Words(table_column=Column(ratio=1, no_wrap=True))
    columns = (TextColumn("{task.description} {task.percentage:3.0f}%"), BarColumn(bar_width=12), words)
    console = Console(stderr=True)
    stages: dict[str, _Stage] = {}
    with Bars(*columns, console=console, refresh_per_second=DRAWS_PER_S, redirect_stdout=False, expand=True) as bars:

        def on_progress(state: RunState) -> None:
            stage = stages.setdefault(state.unit, _Stage(state))
            if stage.bar is None:
                stage.bar = bars.add_task(f"{state.unit}s", total=state.total, stage=stage)
            stage.state, stage.reported = state, time.monotonic()
            bars.update(stage.bar, completed=state.done, total=state.total, refresh=state.done == state.total)

        yield on_progress
