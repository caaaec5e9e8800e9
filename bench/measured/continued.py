"""The fit of a model class continued to the whole record: what is stated where the method that was asked finds none.

Classes are compared on the first cycles (:mod:`bench.measured.classes`). From the fit there windows grow to the whole
record, each from the answer to the last, as in :mod:`bench.measured.grown`.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from bench.contract.estimate import Cost, Status
from bench.contract.problem import Problem
from bench.likelihood.compiled import compiled_output_error
from bench.likelihood.output_error import estimate_at
from bench.measured.classes import ModelClass
from bench.measured.fit import Outcome
from bench.measured.grown import GROWTH, ITERATIONS, LAST_ITERATIONS, window
from bench.measured.linearised import Linearised, at_theta

NAME = "least squares by growing windows"


def continued_fit(one: ModelClass, problem: Problem) -> Outcome | None:
    """The least squares of a record's class from its fit to the first cycles; None where it is not finite.

    Args:
        one: The class, with its fit.
        problem: One record of the class's system without the terms that it does not need, in the user's units.
    """
    started = time.perf_counter()
    found = _continued(one.at, problem.expressed_in(one.units))
    if found is None or found.white is None:
        return None
    estimate = estimate_at(found.model, found.theta, found.white, found.used, Cost())
    wall_s = time.perf_counter() - started
    return Outcome(estimate.expressed_in(one.units.inverse), Status.OK, "", wall_s)


def _continued(first: Linearised, problem: Problem) -> Linearised | None:
    record, theta = problem.records[0], first.theta
    length = GROWTH * first.model.problem.records[0].duration
    if compiled_output_error(problem, first.model.gauge).free != first.model.free:
        return None
    while True:
        last = length >= record.duration
        part = replace(problem, records=(record if last else window(record, length),))
        model = compiled_output_error(part, first.model.gauge)
        with np.errstate(all="ignore"):
            theta = model.settle(theta[None], iterations=LAST_ITERATIONS if last else ITERATIONS)[0]
        if last:
            return at_theta(model, theta)
        length *= GROWTH
