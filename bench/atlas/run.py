"""The blocks of the atlas: fits of a method at several points, computed in one process and stored as statistics.

To save the second process of a sweep, problem and truth are in the same process here; the method is still given the
problem only. A fit fails if it raises an exception or takes longer than :data:`LIMIT_S`.
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

from bench.atlas.forced_test import Forced
from bench.atlas.point import FreeDecay, Point
from bench.atlas.statistics import PointBound, Statistics, columns, score_fit, summarise_fits
from bench.contract.estimate import Estimate, Status
from bench.contract.method import Identifier
from bench.contract.problem import Problem
from bench.entrants.registry import GROUP as METHODS
from bench.entrants.registry import make_method
from bench.errors import InputError
from bench.information.fisher import compute_bound
from bench.isolation.failure import one_line
from bench.isolation.limits import limited
from bench.scenario.scenario import METHOD
from bench.store.cell import scenario_description
from bench.store.results import read_result, write_result
from bench.store.version import described_version
from bench.systems import GROUP as SYSTEMS

LIMIT_S = 60.0
"""Time limit of a fit (s)."""
KINDS = {kind.__name__: kind for kind in (FreeDecay, Forced)}


@dataclass(frozen=True, eq=False)
class PointBlock:
    """A task of the engine: ``replicates`` fits of a method at each of several points."""

    points: Sequence[Point]
    method: str
    settings: dict[str, Any]
    replicates: int
    seed: int
    label: str

    @cached_property
    def key(self) -> str:
        """Digest of points, method with settings, versions, seed and replicates."""
        points = [point.numbers() for point in self.points]
        parts = [points, self.method, self.settings, self.replicates, self.seed, columns(self.quantities), LIMIT_S]
        method = {"method": self.method, "settings": self.settings}
        scenarios = [scenario_description(point.scenario()) for point in self.points]
        versions = [described_version({**method, **scenario}).as_json() for scenario in scenarios]
        text = json.dumps([versions, *parts], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:20]

    @property
    def kind(self) -> tuple[str, str]:
        """The label of the method and the kind of test."""
        return self.label, type(self.points[0]).__name__

    @property
    def used(self) -> set[tuple[str, str]]:
        """The method and the system."""
        return {(METHODS, self.method), (SYSTEMS, self.points[0].scenario().system)}

    @property
    def quantities(self) -> tuple[str, ...]:
        """The quantities that are scored against their bounds."""
        return self.points[0].QUANTITIES

    @property
    def size(self) -> int:
        """The number of fits."""
        return len(self.points) * self.replicates

    @property
    def limit_s(self) -> float:
        """The time after which the process is killed (s), in case a fit cannot be interrupted."""
        return LIMIT_S * (self.size + 1)

    def description(self) -> dict[str, Any]:
        """Return the block as plain values for JSON."""
        names = ("method", "settings", "replicates", "seed", "label")
        points = [asdict(point) for point in self.points]
        return {"test": type(self.points[0]).__name__, "points": points, **{n: getattr(self, n) for n in names}}

    @classmethod
    def from_description(cls, description: Mapping[str, Any], key: str) -> PointBlock:
        """Return the block of a description; raises InputError if its key differs from ``key`` in this version."""
        reason = "this version describes it differently; start the sweep again"
        try:
            content = dict(description)
            kind = KINDS[content.pop("test")]
            block = cls([kind(**point) for point in content.pop("points")], **content)
            if block.key == key:
                return block
        except Exception as error:  # an invalid file can cause any exception
            reason = f"{reason} ({one_line(error)})"
        raise InputError("block", key, reason)

    def stored(self, folder: Path) -> bool:
        """Return whether complete statistics are stored."""
        return read_block(folder, self) is not None

    def compute(self, folder: Path) -> None:
        """Compute and store the statistics; raises InputError if the folder cannot be written."""
        identifier = make_method(self.method, self.settings)
        write_block(folder, self, [fit_point(self, identifier, point) for point in self.points])


def read_block(folder: Path, block: PointBlock) -> list[Statistics] | None:
    """Return the statistics of each point of a block; None if they are missing or damaged."""
    content = read_result(folder, block.key)
    if content is None:
        return None
    rows = np.load(io.BytesIO(content), allow_pickle=False)
    return [Statistics.from_row(row) for row in rows]


def write_block(folder: Path, block: PointBlock, statistics: Sequence[Statistics]) -> None:
    """Store the statistics of each point of a block; raises InputError if the folder cannot be written."""
    content = io.BytesIO()
    np.save(content, np.stack([each.row() for each in statistics]), allow_pickle=False)
    write_result(folder, block.key, content.getvalue())


def fit_point(block: PointBlock, identifier: Identifier, point: Point) -> Statistics:
    """Fit all replicates of a point, and return their statistics."""
    scenario = point.scenario()
    make, bound = scenario.maker(block.seed), bound_at(point)
    fits, failed, seconds = [], [], []
    for i in range(block.replicates):
        problem, truth = make(i)
        started = time.perf_counter()
        estimate = _fit(identifier, problem, scenario.stream(METHOD, block.seed, i))
        seconds.append(time.perf_counter() - started)
        fits.append(_score(estimate, problem, truth, bound))
        failed.append(estimate.status is not Status.OK)
    return summarise_fits(fits, failed, seconds)


def bound_at(point: Point) -> PointBound:
    """Return the Cramér-Rao bound at a point."""
    bound = compute_bound(point.scenario())
    return PointBound({name: bound.relative_sd[name] for name in point.QUANTITIES}, bound.rmse)


def _fit(identifier: Identifier, problem: Problem, rng: np.random.Generator) -> Estimate:
    try:
        with limited(LIMIT_S):
            return identifier.identify(problem, rng).checked()
    except Exception as error:
        return Estimate.failed(problem.system, Status.CRASHED, one_line(error))


def _score(estimate: Estimate, problem: Problem, truth: Any, bound: PointBound) -> np.ndarray:
    """Score an estimate; one that cannot be scored counts as failed."""
    try:
        with np.errstate(all="ignore"):
            return score_fit(estimate, problem, truth, bound)
    except (ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
        return score_fit(Estimate.failed(problem.system, Status.NONFINITE, one_line(error)), problem, truth, bound)
