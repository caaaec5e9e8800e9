"""Solve the problems of a round by a method of this project, from their files alone."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from bench.contract.estimate import Estimate, Status
from bench.contract.method import Identifier
from bench.contract.problem import Problem
from bench.isolation.failure import one_line
from bench.isolation.processes import Died
from bench.records.workers import Workers
from bench.rounds.problem_file import read_problem, short_name
from bench.scenario.stream import anonymous_stream
from bench.scoring.combination import combine_with_prior

LEVEL = 0.95
Rows = list[tuple[str, ...]]


def solve(
    folder: Path, names: Sequence[str], method: Identifier, timeout_s: float, memory_mb: float
) -> Iterator[tuple[Rows, str]]:
    """Yield the rows of each problem with the reason of a failure, if any; each fit has limits of time and memory."""
    requested = [read_problem(folder, name)[1] for name in names]
    with Workers((__name__,)) as workers:
        answers = [
            workers.submit(timeout_s, solve_problem, folder, name, method, number, memory_mb=memory_mb)
            for number, name in enumerate(names)
        ]
        for name, quantities, future in zip(names, requested, answers, strict=True):
            try:
                yield future.result()
            except Died as died:
                rows: Rows = [(name, short_name(quantity), "", "", "", "") for quantity in quantities]
                yield rows, f"{name}: {died.reason}, {died.message}"


def solve_problem(folder: Path, name: str, method: Identifier, seed: int) -> tuple[Rows, str]:
    """Return the rows of a problem, and the reason of a failure, if any."""
    problem, requested = read_problem(folder, name)
    began = time.perf_counter()
    estimate = answer(method, problem, seed)
    seconds = f"{time.perf_counter() - began:.3g}"
    rows: Rows = [(name, short_name(quantity), *_numbers(estimate, quantity), seconds) for quantity in requested]
    return rows, "" if estimate.status is Status.OK else f"{name}: {estimate.status}, {estimate.message}"


def answer(method: Identifier, problem: Problem, seed: int) -> Estimate:
    """Return the estimate of a method, combined with the prior; an exception becomes a failed estimate.

    The random stream comes from a public seed, independent of the streams of the data.
    """
    try:
        return combine_with_prior(method.identify(problem, anonymous_stream(seed)).checked(), problem.prior)
    except Exception as error:
        return Estimate.failed(problem.system, Status.CRASHED, one_line(error))


def _numbers(estimate: Estimate, quantity: str) -> tuple[str, str, str]:
    """Return value and 95 % interval as text; empty if the estimate has none."""
    marginal = estimate.marginal(estimate.system.quantity(quantity)) if estimate.status is Status.OK else None
    if marginal is None or not np.isfinite(marginal.value):
        return "", "", ""
    pieces = marginal.intervals(LEVEL) if marginal.ppf is not None else []
    ends = [f"{end(bounds):.9g}" for end, bounds in zip((min, max), zip(*pieces, strict=True), strict=False)]
    low, high = ends if pieces and np.all(np.isfinite(pieces)) else ("", "")
    return f"{marginal.value:.9g}", low, high
