"""The fits of the atlas: a method over a block of points, in a process, kept as one file of statistics.

A file is named by what it hangs on: points, method with settings and the source that they use, seed and replicates. It
holds numbers only, and is there whole or not at all; so a run that was killed goes on where it was, no block is
computed twice, and a method that changes is computed anew.

A million fits leave no room for a process each, as a sweep has it: problem and truth are in one process here, and a
method is handed the problem alone. A fit ends after :data:`LIMIT_S`; what raises, or ends so, has failed.
"""

from __future__ import annotations

import hashlib
import io
import itertools
import json
import os
import time
import uuid
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

from bench.atlas.engine import PROCESSES, capacity, executor, parent_is_gone
from bench.atlas.point import Point
from bench.atlas.statistics import Least, Statistics, columns, one_fit, pooled
from bench.contract.estimate import Estimate, Status
from bench.contract.method import Identifier
from bench.contract.problem import Problem
from bench.entrants.registry import load_method, make_method
from bench.errors import InputError
from bench.information.fisher import compute_bound
from bench.isolation.failure import one_line
from bench.isolation.limit import limited
from bench.isolation.processes import single_threaded
from bench.scenario.scenario import METHOD
from bench.store.seal import read_regular, write_new
from bench.store.source import digest_of

LIMIT_S = 60.0
AHEAD = 2
"""Blocks that are handed out beyond those that run."""
HARNESS = (
    ("bench.atlas.statistics", "pooled"),
    ("bench.atlas.statistics", "one_fit"),
    ("bench.information.fisher", "compute_bound"),
)


@dataclass(frozen=True, eq=False)
class Task:
    """A method over the points of a block, ``replicates`` fits at each."""

    points: Sequence[Point]
    method: str
    settings: dict[str, Any]
    replicates: int
    seed: int
    label: str

    @cached_property
    def key(self) -> str:
        """What the statistics hang on, as a digest."""
        stated = [point.numbers() for point in self.points]
        parts = [stated, self.method, self.settings, self.replicates, self.seed, columns(self.quantities), LIMIT_S]
        text = json.dumps([_source(self.method, type(self.points[0])), *parts], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:20]

    @property
    def quantities(self) -> tuple[str, ...]:
        """What is scored against a bound."""
        return self.points[0].QUANTITIES

    @property
    def fits(self) -> int:
        """How many."""
        return len(self.points) * self.replicates


@cache
def _source(method: str, kind: type[Point]) -> str:
    """A digest of the definitions that a method, a kind of test and the harness use."""
    return digest_of([*HARNESS, *((cls.__module__, cls.__name__) for cls in (kind, load_method(method)))])


class Blocks:
    """The finished blocks of a folder: each a file of NumPy's with the SHA-256 of its bytes behind them.

    Blocks of before they had one are read as they are.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def holds(self, task: Task) -> bool:
        """Whether a block is finished, and whole."""
        return self.get(task) is not None

    def get(self, task: Task) -> list[Statistics] | None:
        """The statistics of a finished block, point by point; None where there is none, or none that is whole."""
        try:
            content = io.BytesIO(read_regular(self.folder / f"{task.key}.npy"))
            rows = np.load(content, allow_pickle=False)
        except Exception:  # NumPy reads a header as Python, and raises whatever that does
            return None
        size, digest = content.tell(), content.read()
        whole = rows.shape == (len(task.points), len(columns(task.quantities))) and rows.dtype == np.float32
        sound = digest in (b"", hashlib.sha256(content.getvalue()[:size]).digest())
        return [Statistics.of_row(row) for row in rows] if whole and sound else None

    def add(self, task: Task, found: Sequence[Statistics]) -> None:
        """Keep a block; raises InputError where the folder cannot be written."""
        part = self.folder / f"{task.key}.{uuid.uuid4().hex}.part"
        content = io.BytesIO()
        np.save(content, np.stack([statistics.row() for statistics in found]), allow_pickle=False)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            write_new(part, content.getvalue() + hashlib.sha256(content.getvalue()).digest())
            os.replace(part, self.folder / f"{task.key}.npy")
        except OSError as error:
            raise InputError("store", self.folder, f"cannot be written: {error.strerror}") from None


def run(tasks: Sequence[Task], blocks: Blocks, workers: int, engine: str = PROCESSES) -> Iterator[tuple[Task, str]]:
    """Compute what is missing; each task as it ends, and what went wrong. Few wait at a time, so an end is soon."""
    single_threaded()
    missing = iter([task for task in tasks if not blocks.holds(task)])
    most = capacity(engine, workers) + AHEAD
    with executor(engine, workers) as pool:
        waiting = dict[Future[None], Task]()
        try:
            while True:
                for task in itertools.islice(missing, most - len(waiting)):
                    waiting[pool.submit(_computed, task, blocks.folder)] = task
                if not waiting:
                    return
                for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                    error = future.exception()
                    yield waiting.pop(future), one_line(error) if error else ""
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _computed(task: Task, folder: Path) -> None:
    """A block, in a process of its own."""
    identifier = make_method(task.method, task.settings)
    Blocks(folder).add(task, [at_point(task, identifier, point) for point in task.points])


def at_point(task: Task, identifier: Identifier, point: Point) -> Statistics:
    """All replicates of a method at a point."""
    scenario = point.scenario()
    make, least = scenario.maker(task.seed), bound_at(point)
    fits, failed, seconds = [], [], []
    for i in range(task.replicates):
        if parent_is_gone():
            os._exit(1)
        problem, truth = make(i)
        began = time.perf_counter()
        estimate = _fitted(identifier, problem, scenario.stream(METHOD, task.seed, i))
        seconds.append(time.perf_counter() - began)
        fits.append(_scored(estimate, problem, truth, least))
        failed.append(estimate.status is not Status.OK)
    return pooled(fits, failed, seconds)


def bound_at(point: Point) -> Least:
    """The Cramér-Rao bound at a point."""
    bound = compute_bound(point.scenario())
    return Least({name: bound.relative_sd[name] for name in point.QUANTITIES}, bound.rmse)


def _fitted(identifier: Identifier, problem: Problem, rng: np.random.Generator) -> Estimate:
    try:
        with limited(LIMIT_S):
            return identifier.identify(problem, rng).checked()
    except Exception as error:
        return Estimate.failed(problem.system, Status.CRASHED, one_line(error))


def _scored(estimate: Estimate, problem: Problem, truth: Any, least: Least) -> np.ndarray:
    """The scores; of an estimate that cannot be scored, as of a failed one."""
    try:
        with np.errstate(all="ignore"):
            return one_fit(estimate, problem, truth, least)
    except (ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
        return one_fit(Estimate.failed(problem.system, Status.NONFINITE, one_line(error)), problem, truth, least)
