"""The fit step: a method, or other long work on records, in a process of its own within limits of time and memory."""

from __future__ import annotations

import multiprocessing
import pickle
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from bench.config.schema import Job
from bench.contract.estimate import Estimate, Status
from bench.contract.method import Identifier
from bench.contract.problem import Problem
from bench.engine import method_process as fitter
from bench.engine.pool import Limits
from bench.engine.wire import unpack
from bench.entrants.reference import REFERENCES
from bench.entrants.registry import make_method, missing_package
from bench.errors import InputError
from bench.isolation.processes import Children, Died
from bench.records.problem import Measured

Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of a fit: an estimate (maybe a failed one) and what it took, or why there is none."""

    estimate: Estimate | None
    status: Status
    message: str
    wall_s: float = float("nan")


def fit(job: Job, problem: Problem, name: str = "", settings: dict[str, Any] | None = None) -> Outcome:
    """Fit a problem with the method of a job, or with another one by its name and settings, within the job's limits.

    Raises:
        InputError: The method needs the true values, which a measured record does not have.
    """
    name, settings = (name, settings or {}) if name else (job.config.method["name"], settings or job.settings())
    if name in REFERENCES:
        raise InputError("method", name, "it needs the truth, which a measured record does not have; choose a method")
    if lacking_package := missing_package(name):
        return Outcome(None, Status.MISSING_DEPENDENCY, lacking_package)
    rng, limits = np.random.default_rng(job.config.seed), Limits(1, job.config.timeout_s, job.config.memory_mb)
    return fit_alone(make_method(name, settings), problem, problem.records[0].channels[0].times, rng, limits)


def fit_alone(
    method: Identifier, problem: Problem, times: np.ndarray, rng: np.random.Generator, limits: Limits
) -> Outcome:
    """Fit, within the limits; the estimate's functions of time are known at ``times`` (s) afterwards."""
    fit = pickle.dumps(method.identify_many)
    task = fitter.FitTask(fit, (0,), (problem,), (rng,), (times,), limits.timeout_s)
    started = time.perf_counter()
    try:
        (outcome,) = _in_worker(task) if in_worker() else _in_own_process(task, method.requires, limits.memory_mb)
    except Died as died:
        return Outcome(None, Status(died.reason), died.message, time.perf_counter() - started)
    if "answer" not in outcome:
        return Outcome(None, Status(outcome["status"]), outcome["message"])
    estimate = replace(outcome["answer"], system=problem.system).checked()
    return Outcome(estimate, estimate.status, estimate.message, outcome["wall_s"])


def in_worker() -> bool:
    """Return whether this is a process that another one ends at its limits; it may have no children."""
    return multiprocessing.current_process().daemon


def _in_worker(task: fitter.FitTask) -> list[dict[str, Any]]:
    packed = fitter.perform(task)
    assert packed is not None  # as of one replicate
    outcomes: list[dict[str, Any]] = unpack(packed)
    return outcomes


def _in_own_process(task: fitter.FitTask, requires: Sequence[str], memory_mb: float) -> list[dict[str, Any]]:
    with Children() as children:
        return fitter.solve(fitter.ready(children, None, requires, memory_mb), task, memory_mb)


def within_time(work: Callable[[Measured], Result], measured: Measured, limit_s: float) -> Result:
    """Return what a function of a module makes of records; raises ``Died`` where it takes longer than the limit."""
    if in_worker():
        return work(measured)
    with Children() as children:
        child = children.start(_send, pickle.dumps((work, measured)))
        return pickle.loads(child.receive(limit_s))  # type: ignore[no-any-return]


def _send(connection: Any, packed: bytes) -> None:
    work, measured = pickle.loads(packed)
    connection.send_bytes(pickle.dumps(work(measured)))
