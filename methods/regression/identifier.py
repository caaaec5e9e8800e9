"""The frame of methods that read unknowns off many data sets at once: batches, the parametric bootstrap, the answer."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np

from bench import Dimension, Estimate, InputError, NoEstimate, Normal, Problem, Status, layout
from methods.regression.equation import Regression, layout_objection
from methods.starts.band import BandIdentifier

MOST_AT_ONCE = 500_000
"""Displacements that are held together, over all synthetic records of all problems."""


class RegressionIdentifier(BandIdentifier):
    """A method that answers problems of one layout together, each as it would be alone."""

    bootstrap: int
    """Synthetic records for the covariance, 0 for none."""
    uses_start: ClassVar[bool] = True
    """A known initial state is given to ``fit``."""
    works_in = "natural units"

    def __post_init__(self) -> None:
        if self.bootstrap < 0:
            raise InputError("method.bootstrap", self.bootstrap, "a number of records, 0 for no uncertainty")

    @abstractmethod
    def fit(self, regression: Regression, rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Answer the problems of a regression, each with its own generator; raise NoEstimate for what fails all."""

    @property
    def records_held(self) -> int:
        """Count the records that :meth:`fit` holds at once for each problem."""
        return max(1, self.bootstrap)

    def objection(self, problem: Problem) -> str | None:
        return super().objection(problem) or layout_objection(problem)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Estimate groups, or parameters where the scale is known."""
        return self.estimate_many([problem], [rng])[0]

    def estimate_many(self, problems: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Estimate problems of one layout together, so many at a time that their synthetic records fit into memory."""
        if not self.uses_start:
            problems = [without_start(problem) for problem in problems]
        answers: dict[int, Estimate] = {}
        groups: dict[Hashable, list[int]] = {}
        for i, problem in enumerate(problems):
            if sentence := _dead_channel(problem):
                answers[i] = Estimate.failed(problem.system, Status.INVALID, sentence)
            else:
                groups.setdefault(layout(problem), []).append(i)
        for members in groups.values():
            first = problems[members[0]]
            # the steps of a nonlinear motion are chosen for all that are integrated with it: each problem by itself
            size = max(1, MOST_AT_ONCE // (self.records_held * first.n)) if first.system.linear else 1
            for begin in range(0, len(members), size):
                places = members[begin : begin + size]
                answers |= zip(places, self._fit([problems[i] for i in places], [rngs[i] for i in places]), strict=True)
        return [answers[i] for i in range(len(problems))]

    def _fit(self, problems: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        try:
            return self.fit(Regression.of(problems), rngs)
        except NoEstimate as reason:
            return [Estimate.failed(p.system, reason.status, str(reason), reason.cost) for p in problems]


def without_start(problem: Problem) -> Problem:
    """Leave out the initial states, known or not."""
    return replace(problem, records=tuple(replace(record, initial_state=None) for record in problem.records))


def _dead_channel(problem: Problem) -> str:
    for record in problem.records:
        for channel in sorted(record.channels, key=lambda c: c.dof):
            if not np.any(channel.values != channel.values[0]):
                where = f"the measured displacement of DOF {channel.dof + 1}"
                return f"{where} never changes: check the sensor and its cable"
    return ""


def bootstrap_covariances(
    regression: Regression,
    centres: Sequence[np.ndarray],
    noise: Sequence[np.ndarray],
    fitter: Callable[[Regression], np.ndarray],
    rngs: Sequence[np.random.Generator],
    count: int,
) -> list[np.ndarray | None]:
    """Compute covariances (q, q) of what ``fitter`` finds, (sets, q), in ``count`` synthetic data sets a problem.

    The parametric bootstrap (Efron and Tibshirani, An Introduction to the Bootstrap, 1993, section 6.5): records are
    drawn from the response of an estimate, ``centres`` (n_dof, problems, n) a record, plus white noise of its misfit,
    ``noise`` (n_dof, problems) a record. The textbook covariance of a regression is wrong where its columns are noisy
    too (errors in variables). This one measures spread, not bias. None where most sets cannot be fitted, or none are
    drawn.
    """
    if not rngs or not count:
        return [None] * len(rngs)
    drawn = [
        [
            centre[:, [i]] + sd[:, [i], None] * rng.standard_normal((len(centre), count, centre.shape[2]))
            for centre, sd in zip(centres, noise, strict=True)
        ]
        for i, rng in enumerate(rngs)
    ]
    data = regression.with_values([np.concatenate(record, axis=1) for record in zip(*drawn, strict=True)])
    return [covariance(unknowns) for unknowns in fitter(data).reshape(len(rngs), count, -1)]


def covariance(unknowns: np.ndarray) -> np.ndarray | None:
    """Compute the covariance of unknowns (count, q) where they are finite; None where most are not."""
    finite = unknowns[np.all(np.isfinite(unknowns), axis=1)]
    if len(finite) <= max(unknowns.shape[1] + 1, len(unknowns) // 2):
        return None
    return np.atleast_2d(np.cov(finite, rowvar=False))


def answer(
    regression: Regression,
    unknowns: np.ndarray,
    covariance: np.ndarray | None,
    message: str = "",
    hopeless: bool = False,
    traces: Mapping[str, np.ndarray] | None = None,
    dimensions: Mapping[str, Sequence[Dimension]] | None = None,
) -> Estimate:
    """Make the Estimate of unknowns (q,): groups, or parameters where the scale is known.

    Nuisance unknowns are dropped. For parameters the covariance goes to the logarithms to first order. It is a failure
    where unknowns are not finite, where they are ``hopeless``, as the message says, and where parameters are not
    positive.
    """
    system, d = regression.system, len(regression.names)
    mean = unknowns[:d]
    if not np.all(np.isfinite(mean)):
        sentence = "the equations do not determine the parameters: take more samples, or samples of more motion"
        return Estimate.failed(system, Status.DIVERGED, sentence)
    if hopeless:
        return Estimate.failed(system, Status.DIVERGED, message)
    cov = None if covariance is None else covariance[:d, :d]
    spent = unknowns.size + sum(2 * system.n_dof for start in regression.starts if start is None)
    dof = float(max(1, sum(record.n for record in regression.records) - spent))
    parameters = groups = None
    if not regression.scale_known:
        groups = Normal(regression.names, mean, cov, log=False, dof=dof)
    elif np.any(mean <= 0):
        name = regression.names[int(np.argmin(mean))]
        sentence = f"the estimate of {name} is negative: the derivatives are too noisy; take more samples or less noise"
        return Estimate.failed(system, Status.DIVERGED, sentence)
    else:
        cov = None if cov is None else cov / np.outer(mean, mean)
        parameters = Normal(regression.names, np.log(mean), cov, log=True, dof=dof)
    return Estimate(system, parameters, groups, message=message, traces=traces or {}, dimensions=dimensions or {})
