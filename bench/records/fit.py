"""One problem and one method in a process of its own, without a store or a truth: a measured record."""

from __future__ import annotations

import pickle
import time
from dataclasses import dataclass, replace

import numpy as np

from bench.contract.estimate import Estimate, Status
from bench.contract.method import Identifier
from bench.contract.problem import Problem
from bench.engine import method_process as fitter
from bench.engine.pool import Limits
from bench.isolation.processes import Children, Died


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of a fit: an estimate (maybe a failed one) and what it took, or why there is none."""

    estimate: Estimate | None
    status: Status
    message: str
    wall_s: float = float("nan")


def fit_alone(
    method: Identifier, problem: Problem, times: np.ndarray, rng: np.random.Generator, limits: Limits
) -> Outcome:
    """Fit, within the limits; the estimate's functions of time are known at ``times`` (s) afterwards."""
    fit = pickle.dumps(method.identify_many)
    task = fitter.FitTask(fit, (0,), (problem,), (rng,), (times,), limits.timeout_s)
    children = Children()
    started = time.perf_counter()
    try:
        child = fitter.ready(children, None, method.requires, limits.memory_mb)
        (outcome,) = fitter.solve(child, task, limits.memory_mb)
    except Died as died:
        return Outcome(None, Status(died.reason), died.message, time.perf_counter() - started)
    finally:
        children.close()
    if "answer" not in outcome:
        return Outcome(None, Status(outcome["status"]), outcome["message"])
    estimate = replace(outcome["answer"], system=problem.system).checked()
    return Outcome(estimate, estimate.status, estimate.message, outcome["wall_s"])
