"""The problems of a round solved by a method of this project, from their files alone."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from bench.contract.estimate import Estimate, Status
from bench.contract.method import Identifier
from bench.contract.problem import Problem
from bench.isolation.failure import one_line
from bench.rounds.problem_file import read_problem, short_name
from bench.scenario.stream import anonymous_stream
from bench.scoring.combination import combine_with_prior

LEVEL = 0.95
Row = tuple[str, str, str, str, str, str]


def solve(folder: Path, names: Iterable[str], method: Identifier) -> Iterator[tuple[str, list[Row], str]]:
    """Yield the rows of predictions of each problem, and why there is no answer where there is none.

    A method's random streams are those of public seeds, so they have nothing in common with those of the data.
    """
    for number, name in enumerate(names):
        problem, asked = read_problem(folder, name)
        began = time.perf_counter()
        estimate = answer(method, problem, number)
        seconds = f"{time.perf_counter() - began:.3g}"
        rows = [(name, short_name(quantity), *_numbers(estimate, quantity), seconds) for quantity in asked]
        yield name, rows, "" if estimate.status is Status.OK else f"{estimate.status}: {estimate.message}"


def answer(method: Identifier, problem: Problem, seed: int) -> Estimate:
    """Return the answer of a method, combined with the prior; a fault of the method is a failure, too."""
    try:
        estimate = method.identify(problem, anonymous_stream(seed)).checked()
        return combine_with_prior(estimate, problem.prior)
    except Exception as error:  # whatever a method raises
        return Estimate.failed(problem.system, Status.CRASHED, one_line(error))


def _numbers(estimate: Estimate, quantity: str) -> tuple[str, str, str]:
    """Return value and 95 % interval as text; empty where the estimate has none."""
    marginal = estimate.marginal(estimate.system.quantity(quantity)) if estimate.status is Status.OK else None
    if marginal is None or not np.isfinite(marginal.value):
        return "", "", ""
    pieces = marginal.intervals(LEVEL) if marginal.ppf is not None else []
    ends = [min(low for low, _ in pieces), max(high for _, high in pieces)] if pieces else []
    low, high = (f"{end:.9g}" for end in ends) if ends and np.all(np.isfinite(ends)) else ("", "")
    return f"{marginal.value:.9g}", low, high
