"""Problems of one layout are answered at once, and each as it would be alone.

A method brings one function for problems that differ in their data, told starts and priors alone; here they are sorted
by their layout, and handed out so many at a time that their synthetic records fit into memory.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from bench import Estimate, NoEstimate, Problem, layout
from methods.regression.equation import Regression

MOST_AT_ONCE = 500_000
"""Displacements that are held together, over all synthetic records of all problems."""

Finish = Callable[[], Estimate]
"""Makes the answer to one problem; may raise NoEstimate."""
Together = Callable[[Sequence[Regression], Sequence[np.random.Generator]], Sequence[Finish]]
"""Solves problems of one layout, in order, each with its own generator; raises NoEstimate for what fails them all."""


def answers_together(
    problems: Sequence[Problem], rngs: Sequence[np.random.Generator], solve: Together, draws: int
) -> list[Estimate]:
    """Answer the problems, in order, by layouts; ``draws`` records are held for each problem at once."""
    finishes: dict[int, Finish] = {}
    groups: dict[object, list[tuple[int, Regression]]] = {}
    for i, problem in enumerate(problems):
        try:
            regression = Regression.of(problem)
        except NoEstimate as reason:
            finishes[i] = partial(_fail, reason)
        else:
            groups.setdefault(layout(problem), []).append((i, regression))
    for members in groups.values():
        first = problems[members[0][0]]
        # the steps of a nonlinear motion are chosen for all that are integrated with it: each problem by itself
        size = max(1, MOST_AT_ONCE // (draws * first.n)) if first.system.linear else 1
        for at in range(0, len(members), size):
            numbers, regressions = zip(*members[at : at + size], strict=True)
            finishes |= zip(numbers, _solved(solve, regressions, [rngs[i] for i in numbers]), strict=True)
    return [_finished(problem, finishes[i]) for i, problem in enumerate(problems)]


def _solved(
    solve: Together, regressions: Sequence[Regression], rngs: Sequence[np.random.Generator]
) -> Sequence[Finish]:
    try:
        return solve(regressions, rngs)
    except NoEstimate as reason:
        return [partial(_fail, reason)] * len(regressions)


def _fail(reason: NoEstimate) -> Estimate:
    raise reason


def _finished(problem: Problem, finish: Finish) -> Estimate:
    try:
        return finish()
    except NoEstimate as reason:
        return Estimate.failed(problem.system, reason.status, str(reason), reason.cost)
