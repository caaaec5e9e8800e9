"""Combination of estimated parameter groups with the prior.

Free vibration determines k/m and c/m, not m. Methods that estimate all parameters use the prior themselves. For methods
that estimate groups only (LS, RLS, DDNN, SINDy), the same prior is applied here.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import leastsq

from bench.contract.distribution import Normal
from bench.contract.estimate import Estimate, Status
from bench.contract.prior import Prior
from bench.information.fisher import inverse_root
from bench.systems import System


def combine_with_prior(estimate: Estimate, prior: Prior | None) -> Estimate:
    """Convert an estimate of groups into one of parameters by the posterior mode.

    The estimated groups g with covariance S are treated as a measurement of the groups g(p). The log-parameters
    minimise ``(g(p) - g)' S^-1 (g(p) - g) + |(log p - log nominal) / log_sd|²``, which is defined for negative g as
    well. The covariance is that of the linearisation at the minimum (Gauss-Newton). Groups without an estimated
    covariance get a standard deviation of 0.1 % of their value.

    An estimate that has parameters, or has failed, and any estimate without a prior are returned unchanged.
    """
    if estimate.status is not Status.OK or estimate.parameters is not None or estimate.groups is None or prior is None:
        return estimate
    alternatives = tuple(combine_with_prior(other, prior) for other in estimate.alternatives)
    groups, log_mean, log_sds = estimate.groups, prior.log_mean, prior.log_sds
    whiten = _whitening(groups)
    exponents = np.array([estimate.system.quantity(name).vector(prior.names) for name in groups.names])
    coefficients = np.array([estimate.system.quantity(name).coefficient for name in groups.names])
    prior_jacobian = np.diag(1.0 / log_sds)

    def residuals(logs: np.ndarray) -> np.ndarray:
        misfit = whiten @ (coefficients * np.exp(exponents @ logs) - groups.mean)
        return np.concatenate([misfit, (logs - log_mean) / log_sds])

    def jacobian(logs: np.ndarray) -> np.ndarray:
        values = coefficients * np.exp(exponents @ logs)
        return np.concatenate([whiten @ (values[:, None] * exponents), prior_jacobian])

    minima = []
    for start in (log_mean, _initial_guess(estimate.system, groups, prior)):
        if not np.all(np.isfinite(residuals(start))):
            raise ValueError("Residuals are not finite in the initial point.")
        # Tolerances at rounding error, since groups may be known to ten digits. least_squares takes twice the time.
        tight = dict.fromkeys(("xtol", "ftol", "gtol"), 1e-15)
        minima.append(leastsq(residuals, start, Dfun=jacobian, full_output=True, maxfev=500, **tight)[0])
    best = min(minima, key=lambda logs: float(residuals(logs) @ residuals(logs)))
    root = inverse_root(jacobian(best))
    parameters = Normal(prior.names, best, root @ root.T, log=True, dof=groups.dof)
    return replace(estimate, parameters=parameters, groups=None, alternatives=alternatives)


def _whitening(groups: Normal) -> np.ndarray:
    """Return a matrix W such that ``W' W`` is the inverse covariance of the groups."""
    floor = np.diag((1e-3 * np.abs(groups.mean) + 1e-300) ** 2)
    covariance = floor if groups.covariance is None else groups.covariance
    values, vectors = np.linalg.eigh(covariance)
    values = np.maximum(values, 1e-14 * max(values[-1], 1e-300))
    return np.asarray((vectors / np.sqrt(values)).T)


def _initial_guess(system: System, groups: Normal, prior: Prior) -> np.ndarray:
    """Return the log-parameters that follow from the positive groups; the others are nominal."""
    logs = prior.log_mean.copy()
    gauge = prior.names.index(system.gauge)
    for name, value in zip(groups.names, groups.mean, strict=True):
        exponents = system.quantity(name).exponents
        others = [n for n in exponents if n != system.gauge]
        if value > 0 and len(others) == 1 and exponents[others[0]] == 1.0:
            logs[prior.names.index(others[0])] = np.log(value) + logs[gauge]
    return logs
