"""Fit of measured records by a method in a separate process, with limits of time and memory."""

from __future__ import annotations

import math
import multiprocessing
import pickle
import time
from dataclasses import replace
from typing import Any

import numpy as np

from bench.config.schema import Job
from bench.contract.estimate import Estimate, Status
from bench.contract.method import Identifier
from bench.contract.problem import Problem
from bench.engine import method_process
from bench.engine.pool import Limits
from bench.engine.wire import unpack
from bench.entrants.reference import REFERENCES
from bench.entrants.registry import make_method, missing_package
from bench.errors import InputError
from bench.isolation.processes import Children, Died


def fit(job: Job, problem: Problem, settings: dict[str, Any] | None = None) -> tuple[Estimate, float]:
    """Fit a problem with the method of a job.

    Args:
        job: Method, settings, seed and limits.
        problem: The records.
        settings: Settings that replace those of the job.

    Returns:
        The estimate, failed if the method has no result, and the computing time (s), NaN if the fit did not finish.

    Raises:
        InputError: The method is a reference that needs the true values.
    """
    name = job.config.method["name"]
    if name in REFERENCES:
        raise InputError("method", name, "it needs the true values, which are unknown for a record; choose a method")
    if lacking := missing_package(name):
        return Estimate.failed(problem.system, Status.MISSING_DEPENDENCY, lacking), math.nan
    limits = Limits(1, job.config.timeout_s, job.config.memory_mb)
    return fit_alone(make_method(name, settings or job.settings()), problem, limits, job.config.seed)


def fit_alone(method: Identifier, problem: Problem, limits: Limits, seed: int = 0) -> tuple[Estimate, float]:
    """Fit a problem within the limits.

    Returns:
        The estimate, with responses at the samples of the first channel, and the computing time (s), as :func:`fit`.
    """
    times = problem.records[0].channels[0].times
    rng, work = np.random.default_rng(seed), pickle.dumps(method.identify_many)
    task = method_process.FitTask(work, (0,), (problem,), (rng,), (times,), limits.timeout_s)
    started = time.perf_counter()
    try:
        if multiprocessing.current_process().daemon:  # a worker has limits already and may not start children
            packed = method_process.perform(task)
            assert packed is not None  # a task of a single replicate always returns its result
            (result,) = unpack(packed)
        else:
            with Children() as children:
                process = method_process.ready(children, None, method.requires, limits.memory_mb)
                (result,) = method_process.solve(process, task, limits.memory_mb)
    except Died as died:
        seconds = time.perf_counter() - started
        return Estimate.failed(problem.system, Status(died.reason), died.message), seconds
    if "answer" not in result:
        return Estimate.failed(problem.system, Status(result["status"]), result["message"]), math.nan
    return replace(result["answer"], system=problem.system).checked(), result["wall_s"]
