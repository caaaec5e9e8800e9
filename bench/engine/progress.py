"""Progress of a run: how much is done, and how long the rest takes by what the work has cost so far.

Methods differ in cost by a factor of thousands, so costs are averaged by kind of work, e.g. a method on a system. The
cost of starting a task (a process, imported packages) is kept apart from the cost of its fits. The first task of every
kind runs first; the time of work of unknown cost is not guessed: the time left is then displayed as a lower limit.
"""

from __future__ import annotations

import math
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

T = TypeVar("T")
K = TypeVar("K", bound=Hashable)
Kind = tuple[str, str]
"""Two labels, e.g. of a method and a system: where the cost of the pair is unknown, that of the first is taken."""
LINE_S = 30.0
"""Interval of the lines that replace a bar where the error stream is no terminal (s)."""
DRAWS_PER_S = 2


@dataclass(frozen=True)
class Look:
    """State of a run.

    Attributes:
        unit: What is counted, e.g. ``bound`` or ``fit``.
        done: How many of these are done.
        total: Their total number.
        what: Name of the last one.
        seconds_left: Time that the rest of known cost takes; NaN where no cost is known.
        at_least: Whether the cost of some of the rest is unknown.
        tasks_done: Tasks that are complete.
        tasks: Total number of tasks.
        failed: Parts that failed so far.
        task: What a task is called, e.g. ``cell``; empty where it has one part and is not counted.
    """

    unit: str
    done: int
    total: int
    what: str = ""
    seconds_left: float = math.nan
    at_least: bool = True
    tasks_done: int = 0
    tasks: int = 0
    failed: int = 0
    task: str = ""


OnLook = Callable[[Look], None]
"""Called once before the work and whenever some of it is done."""


class Costs:
    """Mean seconds of a piece of work by kind; the first measurement counts only until there is a second.

    The first piece of a kind also pays for what is compiled or imported once.
    """

    def __init__(self) -> None:
        self._measured: dict[Hashable, list[tuple[float, int]]] = defaultdict(list)

    def add(self, kind: Kind, seconds: float, n: int = 1) -> None:
        """Add the cost of ``n`` pieces of work, of the kind and of all kinds with the same first label."""
        for key in (kind, kind[0]):
            known = self._measured[key]
            known.append((seconds, n))
            if len(known) > 2:  # the first, and the sum of the others
                known[1:] = [(known[1][0] + seconds, known[1][1] + n)]

    def each(self, kind: Kind) -> float:
        """Return the seconds of one piece; NaN where nothing is known."""
        known = self._measured.get(kind) or self._measured.get(kind[0])
        return known[-1][0] / known[-1][1] if known else math.nan


class Progress(Generic[K]):
    """Progress of tasks with several parts each, performed by ``workers`` processes."""

    def __init__(
        self,
        unit: str,
        sizes: Mapping[K, int],
        kinds: Mapping[K, Kind],
        workers: int = 1,
        together: Mapping[Kind, int] | None = None,
        task: str = "",
    ) -> None:
        """Count what is to be done.

        Args:
            unit: What the parts are called.
            sizes: Number of parts by task.
            kinds: Kind by task.
            workers: Number of processes.
            together: Parts that one process performs in one step, by kind.
            task: What a task is called, where it has several parts.
        """
        self.unit, self.workers, self.together, self.task = unit, workers, dict(together or {}), task
        self._open, self._kinds = dict(sizes), kinds
        self._begun: set[K] = set()
        self._parts_left, self._tasks_left = Counter[Kind](), Counter[Kind]()
        for key, n in sizes.items():
            self._parts_left[kinds[key]] += n
            self._tasks_left[kinds[key]] += bool(n)
        self._total = sum(sizes.values())
        self._starts, self._parts = Costs(), Costs()
        self._tasks_done = self._failed = 0

    def begin(self) -> Look:
        """Return the state before the first part."""
        return self._look("")

    def add(
        self,
        key: K,
        n: int = 1,
        seconds: float = math.nan,
        start_s: float = 0.0,
        failed: int = 0,
        what: str = "",
    ) -> Look:
        """Count parts of a task that are done.

        Args:
            key: The task.
            n: Number of parts.
            seconds: What they took a worker, without the start; NaN where they were not computed here.
            start_s: What the start of the task took, where these parts were its first.
            failed: How many of them failed.
            what: Name to be displayed.
        """
        kind = self._kinds[key]
        if key not in self._begun:
            self._begun.add(key)
            self._tasks_left[kind] -= bool(self._open[key])
        self._open[key] -= n
        self._parts_left[kind] -= n
        self._tasks_done += self._open[key] == 0
        self._failed += failed
        if math.isfinite(seconds):
            if start_s:
                self._starts.add(kind, start_s)
            if n:
                self._parts.add(kind, seconds, n)
        return self._look(what)

    def _look(self, what: str) -> Look:
        known, longest, unknown = 0.0, 0.0, False
        for kind, n in self._parts_left.items():
            each, start = self._parts.each(kind), self._starts.each(kind)
            if not n:
                continue
            if math.isnan(each):
                unknown = True
                continue
            known += n * each + self._tasks_left[kind] * (0.0 if math.isnan(start) else start)
            longest = max(longest, min(n, self.together.get(kind, 1)) * each)
        return Look(
            unit=self.unit,
            done=self._total - sum(self._parts_left.values()),
            total=self._total,
            what=what,
            seconds_left=math.nan if unknown and not known else max(known / self.workers, longest),
            at_least=unknown,
            tasks_done=self._tasks_done,
            tasks=len(self._open),
            failed=self._failed,
            task=self.task,
        )


def firsts_first(items: Sequence[T], kind: Callable[[T], Hashable]) -> list[T]:
    """Return the items in their order, but the first of every kind before all others, since it measures their cost."""
    first: dict[Hashable, int] = {}
    for i, item in enumerate(items):
        first.setdefault(kind(item), i)
    early = sorted(first.values())
    chosen = set(early)
    return [items[i] for i in early] + [item for i, item in enumerate(items) if i not in chosen]


def duration(seconds: float) -> str:
    """Format a time in the unit that suits it."""
    for size, unit in ((86400.0, "d"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 1.5 * size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.0f} s"


def described(look: Look, since: float, elapsed: float) -> str:
    """Describe a state in words, what matters most first.

    Args:
        look: The state.
        since: Seconds since it was reported.
        elapsed: Seconds since the first report.
    """
    parts = [left_text(look, since)] if look.done < look.total else []
    parts += [f"{look.tasks_done}/{look.tasks} {look.task}s"] if look.task else []
    parts += [f"{look.done}/{look.total} {look.unit}s"]
    parts += [f"{look.failed} failed"] if look.failed else []
    parts += [f"{duration(elapsed)} so far" if look.done < look.total else f"in {duration(elapsed)}"]
    return ", ".join([*parts, look.what] if look.what and look.done < look.total else parts)


def left_text(look: Look, since: float) -> str:
    """Describe the time left; it runs down between two reports."""
    if math.isnan(look.seconds_left):
        return "time left not known yet"
    left = look.seconds_left - since
    if left < 0:
        return "longer than expected" if not look.at_least else "time left not known yet"
    return f"{'at least' if look.at_least else 'about'} {duration(left)} left"


class _Stage:
    """One bar: the last look of a unit, and when it and the first were reported."""

    def __init__(self, look: Look) -> None:
        self.look = look
        self.started = self.seen = self.printed = time.monotonic()

    def words(self) -> str:
        now = time.monotonic()
        return described(self.look, now - self.seen, now - self.started)


@contextmanager
def progress_bar(shown: bool = True) -> Iterator[OnLook]:
    """Show a run's progress on the error stream: a bar a unit in a terminal, else a line now and then."""
    if not shown:
        yield lambda look: None
    elif sys.stderr.isatty():
        with _bars() as on_look:
            yield on_look
    else:
        yield _lines()


@contextmanager
def counter(unit: str, total: int) -> Iterator[Callable[..., None]]:
    """Show the progress of work of one kind; yields a function that counts ``n`` (default 1) more as done."""
    started, done = time.monotonic(), 0
    with progress_bar() as on_look:

        def advance(n: int = 1, what: str = "") -> None:
            nonlocal done
            done += n
            seconds = (time.monotonic() - started) / done * (total - done) if done else math.nan
            on_look(Look(unit, done, max(total, done), what, seconds, False))

        on_look(Look(unit, 0, total))
        yield advance


def _lines() -> OnLook:
    stages: dict[str, _Stage] = {}

    def on_look(look: Look) -> None:
        if look.unit in stages and look.done == look.total == stages[look.unit].look.done:
            return  # its last line is printed
        stage = stages.setdefault(look.unit, _Stage(look))
        stage.look, stage.seen = look, time.monotonic()
        if look.total and (look.done == look.total or stage.seen - stage.printed >= LINE_S):
            stage.printed = stage.seen
            print(f"bench: {look.unit}s {100 * look.done // look.total} %, {stage.words()}", file=sys.stderr)

    return on_look


@contextmanager
def _bars() -> Iterator[OnLook]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, ProgressColumn, TextColumn
    from rich.table import Column
    from rich.text import Text

    class Words(ProgressColumn):
        def render(self, task: Any) -> Text:
            return Text(task.fields["stage"].words(), no_wrap=True, overflow="ellipsis")

    words = Words(table_column=Column(ratio=1, no_wrap=True))
    columns = (TextColumn("{task.description} {task.percentage:3.0f}%"), BarColumn(bar_width=12), words)
    stages: dict[str, tuple[_Stage, Any]] = {}
    bars = Progress(
        *columns, console=Console(stderr=True), refresh_per_second=DRAWS_PER_S, redirect_stdout=False, expand=True
    )
    with bars:

        def on_look(look: Look) -> None:
            if look.unit not in stages:
                stage = _Stage(look)
                stages[look.unit] = stage, bars.add_task(f"{look.unit}s", total=look.total, stage=stage)
            stage, task = stages[look.unit]
            stage.look, stage.seen = look, time.monotonic()
            bars.update(task, completed=look.done, total=look.total, refresh=look.done == look.total)

        yield on_look
