"""The fit of a model class continued to the whole record: what is stated where the method that was asked finds none.

Classes are compared on the first cycles (:mod:`bench.records.classes`). From the fit there windows grow to the whole
record, each from the answer to the last, as in :mod:`bench.records.grown`.
"""

from __future__ import annotations

import time

import numpy as np

from bench.contract.estimate import Cost, Status
from bench.contract.problem import Problem
from bench.likelihood.compiled import compiled_output_error
from bench.likelihood.output_error import estimate_at
from bench.records.classes import ModelClass
from bench.records.fit import Outcome
from bench.records.grown import GROWTH, grown_from

NAME = "least squares by growing windows"


def continued_fit(one: ModelClass, problem: Problem) -> Outcome | None:
    """The least squares of a record's class from its fit to the first cycles; None where it is not finite.

    Args:
        one: The class, with its fit.
        problem: One record of the class's system without the terms that it does not need, in the user's units.
    """
    started = time.perf_counter()
    own, gauge = problem.expressed_in(one.units), one.at.model.gauge
    if compiled_output_error(own, gauge).free != one.at.model.free:
        return None
    with np.errstate(all="ignore"):
        found = grown_from(one.at.theta, own, GROWTH * one.at.model.problem.records[0].duration, gauge)
    if found is None or found.white is None:
        return None
    estimate = estimate_at(found.model, found.theta, found.white, found.used, Cost())
    wall_s = time.perf_counter() - started
    return Outcome(estimate.expressed_in(one.units.inverse), Status.OK, "", wall_s)
