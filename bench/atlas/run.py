"""The blocks of the atlas: the fits of a method at several points, in a process, kept as one file of statistics.

A million fits leave no room for two processes each, as a sweep has them: problem and truth are in one process here, and
a method is given the problem alone. A fit ends after :data:`LIMIT_S`; one that raises, or ends so, has failed.
"""

from __future__ import annotations

import hashlib
import io
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from bench.atlas.forced import Forced
from bench.atlas.point import FreeDecay, Point
from bench.atlas.statistics import Least, Statistics, columns, one_fit, pooled
from bench.contract.estimate import Estimate, Status
from bench.contract.method import Identifier
from bench.contract.problem import Problem
from bench.entrants.registry import make_method
from bench.errors import InputError
from bench.information.fisher import compute_bound
from bench.isolation.failure import one_line
from bench.isolation.limits import limited
from bench.scenario.scenario import METHOD
from bench.store.results import read_result, write_result
from bench.store.version import settings_version

LIMIT_S = 60.0
KINDS = {kind.__name__: kind for kind in (FreeDecay, Forced)}


@dataclass(frozen=True, eq=False)
class PointBlock:
    """A task of the engine: a method at several points, ``replicates`` fits at each."""

    points: Sequence[Point]
    method: str
    settings: dict[str, Any]
    replicates: int
    seed: int
    label: str

    @cached_property
    def key(self) -> str:
        """Return a digest of points, method with settings, versions, seed and replicates."""
        stated = [point.numbers() for point in self.points]
        parts = [stated, self.method, self.settings, self.replicates, self.seed, columns(self.quantities), LIMIT_S]
        version = settings_version(self.method, self.points[0].scenario().system, self.settings).as_json()
        text = json.dumps([version, *parts], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:20]

    @property
    def kind(self) -> tuple[str, str]:
        """Return the label of the method and the kind of test."""
        return self.label, type(self.points[0]).__name__

    @property
    def quantities(self) -> tuple[str, ...]:
        """Return what is scored against a bound."""
        return self.points[0].QUANTITIES

    @property
    def size(self) -> int:
        """Return the number of fits."""
        return len(self.points) * self.replicates

    @property
    def limit_s(self) -> float:
        """Return the limit of time at which the process is killed, if a fit has not let itself be ended."""
        return LIMIT_S * (self.size + 1)

    def stated(self) -> dict[str, Any]:
        """Return all that the block is, as JSON holds it."""
        names = ("method", "settings", "replicates", "seed", "label")
        points = [asdict(point) for point in self.points]
        return {"test": type(self.points[0]).__name__, "points": points, **{n: getattr(self, n) for n in names}}

    @classmethod
    def restored(cls, stated: Mapping[str, Any], key: str) -> PointBlock:
        """Return the block that is stated so; raises InputError where this version would name it otherwise."""
        reason = "this version describes it differently; start the sweep again"
        try:
            content = dict(stated)
            kind = KINDS[content.pop("test")]
            block = cls([kind(**point) for point in content.pop("points")], **content)
            if block.key == key:
                return block
        except Exception as error:  # whatever a file makes of a block that no version has written
            reason = f"{reason} ({one_line(error)})"
        raise InputError("block", key, reason)

    def stored(self, folder: Path) -> bool:
        """Return whether the statistics are stored whole."""
        return read_block(folder, self) is not None

    def compute(self, folder: Path) -> None:
        """Compute and store the statistics; raises InputError where the folder cannot be written."""
        identifier = make_method(self.method, self.settings)
        write_block(folder, self, [at_point(self, identifier, point) for point in self.points])


def read_block(folder: Path, block: PointBlock) -> list[Statistics] | None:
    """Return the statistics of a block, point by point; None where there are none, or they are damaged."""
    content = read_result(folder, block.key)
    if content is None:
        return None
    rows = np.load(io.BytesIO(content), allow_pickle=False)
    return [Statistics.of_row(row) for row in rows]


def write_block(folder: Path, block: PointBlock, statistics: Sequence[Statistics]) -> None:
    """Store the statistics of a block; raises InputError where the folder cannot be written."""
    content = io.BytesIO()
    np.save(content, np.stack([at.row() for at in statistics]), allow_pickle=False)
    write_result(folder, block.key, content.getvalue())


def at_point(block: PointBlock, identifier: Identifier, point: Point) -> Statistics:
    """Compute all replicates of a method at a point."""
    scenario = point.scenario()
    make, least = scenario.maker(block.seed), bound_at(point)
    fits, failed, seconds = [], [], []
    for i in range(block.replicates):
        problem, truth = make(i)
        began = time.perf_counter()
        estimate = _fitted(identifier, problem, scenario.stream(METHOD, block.seed, i))
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
