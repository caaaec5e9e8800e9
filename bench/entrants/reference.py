"""Reference rows of the tables, ``prior`` and ``oracle``, which may use the true values.

``prior``: the nominal values as the estimate, the naive baseline. ``oracle``: maximum a posteriori started at the
truth, what a perfect optimiser gets from the same data and the same prior.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from bench.contract.distribution import Normal
from bench.contract.estimate import Cost, Estimate, Status
from bench.contract.problem import Problem
from bench.dynamics.simulate import fit_initial_state
from bench.likelihood.output_error import OutputError, estimate_at
from bench.scenario.truth import Truth

NOISE_ROUNDS = 6
MOST_ITERATIONS = 100
"""Largest number of trial steps of a search."""


@dataclass(frozen=True, eq=False)
class _ExactOutputError(OutputError):
    """The likelihood with every motion integrated alone, which is more accurate for a nonlinear system."""

    def jacobian(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Predictions (cases, N) and derivatives (cases, N, size); a neighbour that diverged gives no derivative."""
        predicted, slopes = super().jacobian(theta)
        if self.system.linear:
            return predicted, slopes
        return np.stack([self.predict(vector) for vector in theta]), np.where(np.isfinite(slopes), slopes, 0.0)


def prior_estimate(problem: Problem, truth: Truth) -> Estimate:
    """Return the nominal values and the covariance of the prior, without using the data."""
    if problem.prior is None:
        return Estimate.failed(problem.system, Status.UNSUPPORTED, "there is no prior in this scenario")
    prior = problem.prior
    distribution = Normal(prior.names, prior.log_mean, np.diag(prior.log_sds**2), log=True)
    starts = tuple(fit_initial_state(problem.system, prior.nominal, record) for record in problem.records)
    return Estimate(problem.system, parameters=distribution, initial_states=starts, message="the nominal values")


def oracle_estimate(problem: Problem, truth: Truth) -> Estimate:
    """Return the maximum a posteriori from the truth; noise level from the residuals (N - p degrees of freedom).

    Fit and noise level, one for all channels, are iterated to a fixed point. p counts the directions that the data
    inform: groups where nothing but the prior sets the scale, else parameters; and the initial state where it is not
    known.
    """
    system, true = problem.system, truth.parameters
    model = _ExactOutputError(problem, gauge=true[system.gauge])
    p_data = (len(system.names) if problem.scale_known else len(system.groups)) + model.size - len(model.free)
    dof, size = max(problem.n - p_data, 1), float(np.max(np.abs(truth.dense_displacement)))
    start = [*truth.initial_state.displacement, *truth.initial_state.velocity] * len(model.unknown_starts)
    theta = np.concatenate([np.log([true[name] for name in model.free]), start])
    level, evaluations = max(float(np.mean(truth.sigma)), 1e-12 * size), 0
    point = model.point(theta[None])
    for _ in range(NOISE_ROUNDS):
        sigma = np.full((1, len(model.channels)), level)
        point, end = model.search(point, sigma, MOST_ITERATIONS, polished=True)
        evaluations += int(end.iterations[0]) + 1
        before, level = level, max(float(np.sqrt(np.sum((model.data - point.predicted) ** 2) / dof)), 1e-14 * size)
        if abs(level / before - 1) < 1e-6:
            break
    slopes = model.standardised(point, sigma).slopes[0]
    scale, covariance = np.linalg.norm(slopes, axis=0), None
    if np.all(scale > 0) and np.all(np.isfinite(slopes)):  # else a parameter ran to zero: no interval of its logarithm
        covariance = np.linalg.pinv((slopes / scale).T @ (slopes / scale)) / np.outer(scale, scale)
    estimate = estimate_at(model, point.theta[0], covariance, p_data, Cost(evaluations=evaluations))
    return replace(estimate, offsets=None)


REFERENCES: dict[str, Callable[[Problem, Truth], Estimate]] = {"prior": prior_estimate, "oracle": oracle_estimate}
"""Reference rows by name; on the command line ``method=oracle`` works like any method."""
