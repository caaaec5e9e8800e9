"""The rows that every table carries beside the methods: ``prior`` and ``oracle``; they may see the truth.

``prior``: the nominal values as the estimate, the naive baseline. ``oracle``: maximum a posteriori started at the
truth, what a perfect optimiser gets from the same data and the same prior.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from bench.estimate import Cost, Estimate, Normal, Status
from bench.problem import InitialState, Problem
from bench.simulate import SimulatedResponse, fitted_start, measurements
from bench.truth import Truth

NOISE_ROUNDS = 6
STEP = 1e-5
"""Of central differences by log-parameters and by the start over its size; for all of them at once."""


def prior_estimate(problem: Problem, truth: Truth) -> Estimate:
    """The nominal values and the prior's own covariance: what is known before any measurement."""
    if problem.prior is None:
        return Estimate.failed(problem.system, Status.UNSUPPORTED, "there is no prior in this scenario")
    prior = problem.prior
    belief = Normal(prior.names, prior.log_mean, np.diag(prior.log_sds**2), log=True)
    starts = tuple(fitted_start(problem.system, prior.nominal, record) for record in problem.records)
    return Estimate(problem.system, parameters=belief, initial_states=starts, message="the nominal values")


def oracle_estimate(problem: Problem, truth: Truth) -> Estimate:
    """Maximum a posteriori from the truth, noise level estimated from the residuals (N - p degrees of freedom).

    Fit and noise level are iterated to a fixed point. p counts the directions that the data inform: groups where
    nothing but the prior sets the scale, else parameters; and the initial state where it is not told.
    """
    system, prior = problem.system, problem.prior
    n, names = system.n_dof, system.names
    unknown = [record for record in problem.records if record.initial_state is None]
    p_data = (len(names) if problem.scale_told else len(system.groups)) + 2 * n * len(unknown)
    dof = max(problem.n - p_data, 1)
    size = float(np.max(np.abs(truth.dense_displacement)))
    scale = np.tile([*[size] * n, *[size / problem.records[0].duration] * n], len(unknown))
    fixed_gauge = prior is None and not problem.scale_told
    free = [name for name in names if not (fixed_gauge and name == system.gauge)]
    y = np.concatenate([channel.values for record in problem.records for channel in record.channels])
    evaluations = 0

    def unpack(theta: np.ndarray) -> tuple[dict[str, Any], list[tuple[np.ndarray, np.ndarray]]]:
        """Parameters and the start of each record; of many sets at once where theta has the shape (unknowns, sets)."""
        own = {name: np.exp(value) for name, value in zip(free, theta, strict=False)}
        states, rest = [], (theta[len(free) :].T * scale).T
        for record in problem.records:
            if record.initial_state is None:
                states.append((rest[:n], rest[n : 2 * n]))
                rest = rest[2 * n :]
            else:
                states.append((record.initial_state.displacement, record.initial_state.velocity))
        return {**truth.parameters, **own}, states

    def predicted(theta: np.ndarray) -> np.ndarray:
        nonlocal evaluations
        evaluations += 1 if theta.ndim == 1 else theta.shape[1]
        p, states = unpack(theta)
        pairs = zip(problem.records, states, strict=True)
        return np.concatenate([measurements(system, p, state, record) for record, state in pairs], axis=-1)

    def misfit(theta: np.ndarray) -> np.ndarray:
        return predicted(theta) - y

    def objective(theta: np.ndarray, sigma: float) -> np.ndarray:
        residual = misfit(theta) / sigma
        if prior is None:
            return residual
        return np.concatenate([residual, prior.residuals(theta[: len(names)])])

    def slopes(theta: np.ndarray, sigma: float) -> np.ndarray:
        moved = STEP * np.eye(theta.size)
        both = predicted(theta[:, None] + np.hstack([moved, -moved]))
        jacobian = (both[: theta.size] - both[theta.size :]).T / (2.0 * STEP * sigma)
        if prior is None:
            return np.asarray(jacobian)
        own = np.eye(len(names), theta.size) / prior.log_sds[:, None]
        return np.vstack([jacobian, own])

    from scipy.optimize import least_squares  # slow to import, and few need it

    starts = np.tile([*truth.initial_state.displacement, *truth.initial_state.velocity], len(unknown)) / scale
    theta = np.concatenate([np.log([truth.parameters[name] for name in free]), starts])
    sigma = max(float(np.mean(truth.sigma)), 1e-12 * size)
    for _ in range(NOISE_ROUNDS):
        fit = least_squares(objective, theta, slopes, args=(sigma,), method="lm", xtol=1e-13, ftol=1e-13)
        theta = fit.x
        before, sigma = sigma, max(float(np.sqrt(np.sum(misfit(theta) ** 2) / dof)), 1e-14 * size)
        if abs(sigma / before - 1) < 1e-6:
            break
    p, started = unpack(theta)
    p, states = {name: float(value) for name, value in p.items()}, [InitialState(*start) for start in started]
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac)[: len(free), : len(free)]
    cost = Cost(evaluations=evaluations)
    responses = tuple(
        SimulatedResponse(r.rig(system), p, s, r.forces) for s, r in zip(states, problem.records, strict=True)
    )
    common = {"reconstructions": responses, "initial_states": tuple(states), "cost": cost}
    if not fixed_gauge:
        belief = Normal(names, theta[: len(names)], covariance, log=True, dof=dof)
        return Estimate(system, parameters=belief, message=str(fit.message), **common)  # type: ignore[arg-type]
    values = np.array([group.value(p) for group in system.groups])
    gradient = values[:, None] * np.array([group.vector(free) for group in system.groups])
    groups = Normal(tuple(g.name for g in system.groups), values, gradient @ covariance @ gradient.T, False, dof)
    return Estimate(system, groups=groups, message=str(fit.message), **common)  # type: ignore[arg-type]


REFERENCES: dict[str, Callable[[Problem, Truth], Estimate]] = {"prior": prior_estimate, "oracle": oracle_estimate}
"""Reference rows by name; on the command line ``method=oracle`` works like any method."""
