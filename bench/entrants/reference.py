"""The rows that every table carries beside the methods: ``prior`` and ``oracle``; they may see the truth.

``prior``: the nominal values as the estimate, the naive baseline. ``oracle``: maximum a posteriori started at the
truth, what a perfect optimiser gets from the same data and the same prior.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from bench.contract.belief import Normal
from bench.contract.estimate import Cost, Estimate, Status
from bench.contract.problem import Problem
from bench.dynamics.simulate import fitted_start
from bench.likelihood.output_error import OutputError, Standardised, estimate_at
from bench.scenario.truth import Truth

NOISE_ROUNDS = 6


def prior_estimate(problem: Problem, truth: Truth) -> Estimate:
    """Return the nominal values and the covariance of the prior: what is known before any measurement."""
    if problem.prior is None:
        return Estimate.failed(problem.system, Status.UNSUPPORTED, "there is no prior in this scenario")
    prior = problem.prior
    belief = Normal(prior.names, prior.log_mean, np.diag(prior.log_sds**2), log=True)
    starts = tuple(fitted_start(problem.system, prior.nominal, record) for record in problem.records)
    return Estimate(problem.system, parameters=belief, initial_states=starts, message="the nominal values")


def oracle_estimate(problem: Problem, truth: Truth) -> Estimate:
    """Return the maximum a posteriori from the truth; noise level from the residuals (N - p degrees of freedom).

    Fit and noise level, one for all channels, are iterated to a fixed point. p counts the directions that the data
    inform: groups where nothing but the prior sets the scale, else parameters; and the initial state where it is not
    known.
    """
    from scipy.optimize import least_squares  # slow to import, and few need it

    system, true = problem.system, truth.parameters
    model = OutputError(problem, gauge=true[system.gauge])
    p_data = (len(system.names) if problem.scale_told else len(system.groups)) + model.size - len(model.free)
    dof, size = max(problem.n - p_data, 1), float(np.max(np.abs(truth.dense_displacement)))
    start = [*truth.initial_state.displacement, *truth.initial_state.velocity] * len(model.unknown_starts)
    theta = np.concatenate([np.log([true[name] for name in model.free]), start])
    sigma, evaluations = max(float(np.mean(truth.sigma)), 1e-12 * size), 0
    for _ in range(NOISE_ROUNDS):
        aim = Standardised(model, np.full(len(model.channels), sigma), exact=True)
        fit = least_squares(aim.residuals, theta, aim.jacobian, method="lm", xtol=1e-13, ftol=1e-13)
        theta, evaluations = fit.x, evaluations + aim.evaluations + 1
        left = model.data - model.predict(theta)
        before, sigma = sigma, max(float(np.sqrt(np.sum(left**2) / dof)), 1e-14 * size)
        if abs(sigma / before - 1) < 1e-6:
            break
    scale, covariance = np.linalg.norm(fit.jac, axis=0), None
    if np.all(scale > 0) and np.all(np.isfinite(fit.jac)):  # else a parameter ran to zero: no interval of its logarithm
        covariance = np.linalg.pinv((fit.jac / scale).T @ (fit.jac / scale)) / np.outer(scale, scale)
    estimate = estimate_at(model, theta, covariance, p_data, Cost(evaluations=evaluations), str(fit.message))
    return replace(estimate, offsets=None)


REFERENCES: dict[str, Callable[[Problem, Truth], Estimate]] = {"prior": prior_estimate, "oracle": oracle_estimate}
"""Reference rows by name; on the command line ``method=oracle`` works like any method."""
