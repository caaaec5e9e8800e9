"""The scores of one replicate: an estimate against the truth, as named numbers."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bench.contract.belief import Marginal, Normal, standard_quantile
from bench.contract.estimate import Estimate, Status
from bench.contract.problem import Problem
from bench.dynamics.simulate import fitted_start, simulate
from bench.scenario.truth import Truth
from bench.systems import Quantity

LEVELS = (0.50, 0.80, 0.95)
"""Levels of the intervals whose coverage is scored."""
QUANTILES = (np.arange(200) + 0.5) / 200
"""Levels at which the CRPS integral is sampled."""


def score(estimate: Estimate, problem: Problem, truth: Truth) -> dict[str, float]:
    """Named scores; a score that this estimate cannot have is absent. Failed estimates have none.

    ``<quantity>_error_pct`` (absolute relative error, %), ``<quantity>_ratio`` (the value over the true one),
    ``<quantity>_coverage_50`` etc. (1 if the interval holds the truth, else 0), ``<quantity>_pit`` (the belief's level
    at the truth, uniform over replicates if it is calibrated: probability integral transform),
    ``<quantity>_interval_score_pct`` (95 %) and ``<quantity>_crps_pct`` relative to the truth, in %;
    ``rmse`` (of the reconstruction), ``rmse_simulated``, ``rmse_forecast`` (m), over the DOFs with a sensor;
    ``band_inside_50`` etc.: the share of the record where the displacement lies in the method's own band.
    """
    if estimate.status is not Status.OK:
        return {}
    scores: dict[str, float] = {}
    for quantity in problem.system.quantities:
        marginal = estimate.marginal(quantity)
        if marginal is not None:
            scores |= _quantity_scores(quantity, marginal, float(quantity.value(truth.parameters)))
    return scores | _displacement_scores(estimate, problem, truth) | _band_scores(estimate, truth)


def _quantity_scores(quantity: Quantity, marginal: Marginal, true: float) -> dict[str, float]:
    name = quantity.name
    ratio = marginal.value / true
    scores = {f"{name}_error_pct": 100.0 * abs(ratio - 1.0), f"{name}_ratio": ratio}
    if marginal.ppf is None or marginal.cdf is None:
        return scores
    scores[f"{name}_pit"] = marginal.cdf(true)
    for level in LEVELS:
        low, high = marginal.interval(level)
        scores[f"{name}_coverage_{round(100 * level)}"] = float(low <= true <= high)
    low, high = marginal.interval(0.95)
    scores[f"{name}_interval_score_pct"] = 100.0 * interval_score(low, high, true, 0.95) / true
    scores[f"{name}_crps_pct"] = 100.0 * crps(marginal.ppf(QUANTILES), true) / true
    return scores


def interval_score(low: float, high: float, true: float, level: float) -> float:
    """Width plus ``2/alpha`` times the miss (Gneiting & Raftery, J. Am. Stat. Assoc. 102:359, 2007, eq. 43)."""
    alpha = 1.0 - level
    return (high - low) + 2.0 / alpha * (max(low - true, 0.0) + max(true - high, 0.0))


def crps(quantiles: np.ndarray, true: float) -> float:
    """Continuous ranked probability score from quantiles at :data:`QUANTILES`.

    Twice the mean quantile (pinball) score over the levels (Gneiting & Ranjan, J. Bus. Econ. Stat. 29:411, 2011).
    """
    return float(2.0 * np.mean((quantiles - true) * ((true < quantiles) - QUANTILES)))


def point_parameters(estimate: Estimate) -> Mapping[str, float] | None:
    """Parameter values for a simulation; from groups alone, with the gauge mass at 1 (free response has no scale)."""
    if estimate.parameters is not None:
        return estimate.parameters.values()
    if estimate.groups is None:
        return None
    system = estimate.system
    p = dict.fromkeys(system.names, 1.0)
    for name, value in estimate.groups.values().items():
        numerator = next(n for n, power in system.quantity(name).exponents.items() if power > 0)
        p[numerator] = value
    return p


def _displacement_scores(estimate: Estimate, problem: Problem, truth: Truth) -> dict[str, float]:
    p = point_parameters(estimate)
    record = problem.records[0]
    scores: dict[str, float] = {}
    if p is not None:
        start = estimate.initial_states[0] if estimate.initial_states else fitted_start(problem.system, p, record)
        times = np.concatenate([truth.dense_times, truth.forecast_times])
        response = simulate(record.rig(problem.system), p, start, times, record.forces).displacement
        n = truth.dense_times.size
        scores["rmse_simulated"] = _rms(truth.scored(response[:, :n] - truth.dense_displacement))
        scores["rmse_forecast"] = _rms(truth.scored(response[:, n:] - truth.forecast_displacement))
        scores["rmse"] = scores["rmse_simulated"]
    if estimate.reconstructions:
        error = estimate.reconstructions[0](truth.dense_times) - truth.dense_displacement
        scores["rmse"] = _rms(truth.scored(error))
    return scores


def _band_scores(estimate: Estimate, truth: Truth) -> dict[str, float]:
    if not estimate.bands or not estimate.reconstructions:
        return {}
    dof = estimate.belief.dof if isinstance(estimate.belief, Normal) else None
    sd = truth.scored(estimate.bands[0](truth.dense_times))
    off = np.abs(truth.scored(estimate.reconstructions[0](truth.dense_times) - truth.dense_displacement))
    quantiles = {v: float(standard_quantile(0.5 + v / 2, dof)) for v in LEVELS}
    return {f"band_inside_{round(100 * v)}": float(np.mean(off <= quantiles[v] * sd)) for v in LEVELS}


def _rms(error: np.ndarray) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        value = float(np.sqrt(np.mean(error**2)))
    return value if np.isfinite(value) else float("inf")
