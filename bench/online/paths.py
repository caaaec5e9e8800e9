"""The track's runs: each tracker over each replicate of each scenario, kept as one file of arrays a replicate.

A file is named by what the run hangs on: scenario, method with its settings and the source that they use, seed and
replicate. So a method that changes is run anew, and what is stored is never misread. It holds numbers only, so that
nothing in a store can be executed.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from functools import cached_property
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from bench.entrants.online import make_online
from bench.entrants.registry import load_method
from bench.errors import InputError
from bench.isolation.failure import one_line
from bench.isolation.processes import compiled_single_threaded, single_threaded
from bench.online.follow import Followed, follow
from bench.online.scenario import OnlineScenario
from bench.store.source import digest_of

HARNESS = (("bench.online.scenario", "OnlineScenario"), ("bench.online.follow", "follow"))
"""What makes the data and drives a tracker."""


@dataclass(frozen=True, eq=False)
class Task:
    """All replicates of a scenario by a method; ``label`` is what the table calls it, a variant by its own name."""

    scenario: OnlineScenario
    method: str
    settings: dict[str, Any]
    replicates: int
    seed: int = 0
    label: str = ""

    @cached_property
    def source(self) -> str:
        """A digest of the definitions that a run uses."""
        cls = type(make_online(self.method, self.settings))
        roots = [*HARNESS, (cls.__module__, cls.__name__)]
        if isinstance(batch := getattr(make_online(self.method, self.settings), "batch", None), str):
            own = load_method(batch)
            roots.append((own.__module__, own.__name__))
        return digest_of(roots)

    def key(self, replicate: int) -> str:
        """What a run hangs on, as a digest."""
        parts = [self.source, self.scenario.identity, self.method, self.settings, self.seed, replicate]
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:20]


class Paths:
    """The finished runs of a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def holds(self, key: str) -> bool:
        """Whether a run is finished."""
        return (self.folder / f"{key}.npz").is_file()

    def get(self, key: str) -> Followed | None:
        """A finished run; None where there is none, or it cannot be read."""
        try:
            with np.load(self.folder / f"{key}.npz", allow_pickle=False) as kept:
                return Followed(**{name: kept[name] if kept[name].ndim else kept[name].item() for name in kept.files})
        except (OSError, ValueError, TypeError, KeyError):
            return None

    def add(self, key: str, path: Followed) -> None:
        """Keep a run; a file is there whole or not at all."""
        place = self.folder / f"{key}.npz"
        part = self.folder / f"{key}.{os.getpid()}.part.npz"
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            np.savez_compressed(part, **asdict(path))
            os.replace(part, place)
        except OSError as error:
            raise InputError("store", self.folder, f"cannot be written: {error.strerror}") from None


def missing(task: Task, paths: Paths) -> list[int]:
    """The replicates that are to be run."""
    return [i for i in range(task.replicates) if not paths.holds(task.key(i))]


def run(tasks: Sequence[Task], paths: Paths, workers: int) -> Iterator[tuple[Task, int, str]]:
    """Run what is missing, replicate by replicate; (task, replicate, what went wrong) as each ends."""
    single_threaded()
    compiled_single_threaded()
    jobs = [(task, i) for task in tasks for i in missing(task, paths)]
    places = {scenario: i for i, scenario in enumerate(dict.fromkeys(task.scenario.identity for task in tasks))}
    # methods on one stream one behind the other: what they find of its first samples is the same
    jobs.sort(key=lambda job: (places[job[0].scenario.identity], job[1]))
    context = get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        waiting = {pool.submit(_replicate, task, i, paths.folder): (task, i) for task, i in jobs}
        try:
            for done in as_completed(waiting):
                task, i = waiting[done]
                error = done.exception()
                yield task, i, one_line(error) if error else ""
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _replicate(task: Task, replicate: int, folder: Path) -> None:
    """One run, in a process of its own."""
    path = follow(make_online(task.method, task.settings), task.scenario.stream(task.seed, replicate))
    Paths(folder).add(task.key(replicate), path)
