"""Initial guesses from the prior for motions above half the sampling rate.

Such samples cannot be differentiated, so a regression of the equation of motion gives no guess. For one nonlinear
degree of freedom the time of the prior's nominal motion is rescaled. For several degrees of freedom, where each mode
may have its own alias, parameters are drawn from the prior. The guesses with the best fit are kept.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bench import OutputError, System
from methods.starts.search_range import UP, expected_rate

MOST_SPEEDS = 120
"""Largest number of time scales tried."""
RADIANS_APART = 1.5
"""Phase difference of successive time scales at the end of the record: half the half-cycle between two minima."""
DRAWS = 128
"""Points of a Halton sequence, mapped to the prior, at which a response of several degrees of freedom is compared."""
BEST = 16
"""Number of draws kept as initial guesses."""


def sped_up(system: System, p: Mapping[str, float], factor: float) -> dict[str, float]:
    """Return parameters of the same motion in rescaled time; damping, which is known least, is unchanged."""
    return {q.name: p[q.name] * (1.0 if q.kind == "damping" else factor**-q.dimension.time) for q in system.parameters}


def best_speeds(model: OutputError, n: int) -> list[dict[str, float]]:
    """Return the ``n`` best local minima of the misfit over the time scale of the nominal motion, in natural units."""
    problem, expected = model.problem, expected_rate(model.problem)
    assert problem.prior is not None
    assert expected is not None
    centre, sd = expected
    phase = np.exp(centre + UP * sd) * max(record.duration for record in problem.records)
    count = int(np.clip(2 * UP * sd * phase / RADIANS_APART, 8, MOST_SPEEDS))
    factors = np.exp(np.linspace(-UP * sd, UP * sd, count))
    starts = [sped_up(problem.system, problem.prior.nominal, factor) for factor in factors]
    profiles = _profiles(model, np.log([[p[name] for name in model.free] for p in starts]))
    padded = np.concatenate([[np.inf], profiles, [np.inf]])
    minima = np.flatnonzero((padded[1:-1] <= padded[:-2]) & (padded[1:-1] < padded[2:]))
    return [starts[i] for i in minima[np.argsort(padded[1:-1][minima])][:n]]


def best_draws(model: OutputError) -> list[dict[str, float]]:
    """Return the draws from the prior that fit best, in natural units; the same draws for the same prior."""
    from scipy.stats import norm, qmc  # slow to import

    prior = model.problem.prior
    assert prior is not None
    points = norm.ppf(qmc.Halton(len(model.free), scramble=False).random(DRAWS + 1)[1:])  # the first point is 0
    logs = np.log([prior.nominal[name] for name in model.free]) + points * [prior.log_sd[name] for name in model.free]
    best = np.argsort(_profiles(model, logs))[:BEST]
    return [dict(prior.nominal) | dict(zip(model.free, map(float, np.exp(logs[i])), strict=True)) for i in best]


def _profiles(model: OutputError, logs: np.ndarray) -> np.ndarray:
    """Return minus twice the log-posterior at log-parameters (n, k), each with the best initial state."""
    thetas = np.zeros((len(logs), model.size))
    thetas[:, : len(model.free)] = logs
    with np.errstate(all="ignore"):
        profiles = model.profile(model.with_initial_states(thetas))
    return np.where(np.isfinite(profiles), profiles, np.inf)
