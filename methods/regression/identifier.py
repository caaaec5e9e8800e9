"""Base class of regression methods: batches of problems, the parametric bootstrap, and the estimate."""

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
"""Largest number of displacements in memory, over all synthetic records of all problems."""


class RegressionIdentifier(BandIdentifier):
    """A method that solves problems of one layout in a batch, with the same results as one by one."""

    bootstrap: int
    """Number of synthetic records for the covariance, 0 for no covariance."""
    uses_start: ClassVar[bool] = True
    """True where a known initial state is given to ``fit``."""
    works_in = "natural units"

    def __post_init__(self) -> None:
        if self.bootstrap < 0:
            raise InputError("method.bootstrap", self.bootstrap, "a number of records, 0 for no uncertainty")

    @abstractmethod
    def fit(self, regression: Regression, rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Estimate the problems of a regression, each with its generator; raise NoEstimate where all fail."""

    @property
    def records_held(self) -> int:
        """Return the number of records per problem that :meth:`fit` has in memory."""
        return max(1, self.bootstrap)

    def objection(self, problem: Problem) -> str | None:
        return super().objection(problem) or layout_objection(problem)

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Estimate groups, or parameters where the scale is known."""
        return self.estimate_many([problem], [rng])[0]

    def estimate_many(self, problems: Sequence[Problem], rngs: Sequence[np.random.Generator]) -> list[Estimate]:
        """Estimate problems in batches of one layout whose synthetic records fit into memory."""
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
            # integration steps of nonlinear motions depend on the whole batch, so these problems are not batched
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
    """Remove the known initial states."""
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
    """Compute covariances (q, q) by the parametric bootstrap.

    Synthetic records are the response of an estimate plus white noise of its misfit (Efron and Tibshirani, An
    Introduction to the Bootstrap, 1993, section 6.5). The textbook covariance of a regression is wrong where its
    columns are noisy (errors in variables). The bootstrap measures spread, not bias.

    Args:
        regression: The data of all problems.
        centres: Response of each estimate, (n_dof, problems, n) per record.
        noise: Standard deviation of the misfit, (n_dof, problems) per record.
        fitter: Returns the unknowns (sets, q) of synthetic data.
        rngs: One generator per problem.
        count: Synthetic data sets per problem.

    Returns:
        One covariance per problem; None where most fits fail or ``count`` is 0.
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
    """Return the covariance of the finite ones of unknowns (count, q); None where most are not finite."""
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
    """Return the Estimate of unknowns (q,): of groups, or of parameters where the scale is known.

    Nuisance unknowns are dropped. The covariance of log-parameters is of first order. The estimate has failed where
    unknowns are not finite or ``hopeless`` (with the message), or parameters are not positive.
    """
    system, d = regression.system, len(regression.names)
    mean = unknowns[:d]
    if not np.all(np.isfinite(mean)):
        sentence = "the equations do not determine the parameters: more samples or more motion are required"
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
        sentence = f"the estimate of {name} is negative: the derivatives are too noisy"
        return Estimate.failed(system, Status.DIVERGED, sentence)
    else:
        cov = None if cov is None else cov / np.outer(mean, mean)
        parameters = Normal(regression.names, np.log(mean), cov, log=True, dof=dof)
    return Estimate(system, parameters, groups, message=message, traces=traces or {}, dimensions=dimensions or {})
