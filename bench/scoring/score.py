"""Scores of estimates against the true values; replicates whose estimates have the same form are scored as arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bench.contract.distribution import Marginal, Normal, standard_quantile
from bench.contract.estimate import Estimate, Status
from bench.contract.problem import Problem
from bench.dynamics.simulate import displacements, fit_initial_state
from bench.scenario.truth import Truth
from bench.systems import Quantity

LEVELS = (0.50, 0.80, 0.95)
"""Nominal levels of the intervals whose coverage is scored."""
QUANTILES = (np.arange(200) + 0.5) / 200
"""Levels at which the integral of the continuous ranked probability score (CRPS) is sampled."""

Columns = dict[str, np.ndarray]
"""Scores by name, each (n,)."""


def score(estimate: Estimate, problem: Problem, truth: Truth) -> dict[str, float]:
    """Score one replicate; see :func:`scores`."""
    return {name: float(values[0]) for name, values in scores([estimate], [problem], [truth]).items()}


def scores(estimates: Sequence[Estimate], problems: Sequence[Problem], truths: Sequence[Truth]) -> Columns:
    """Score the replicates of one scenario.

    Returns:
        Scores by name, each (n,), NaN where the estimate failed or does not state the quantity.

        - ``<quantity>_error_pct``: absolute relative error, %; ``<quantity>_ratio``: estimate over true value.
        - ``<quantity>_coverage_50`` etc.: 1 if the interval covers the true value, else 0.
        - ``<quantity>_pit``: probability integral transform, the estimated distribution function at the true value.
        - ``<quantity>_interval_score_pct`` (95 %), ``<quantity>_crps_pct``: relative to the true value, %.
        - ``rmse`` (of the reconstruction), ``rmse_simulated``, ``rmse_forecast``: displacement errors (m) over the
          degrees of freedom with a sensor.
        - ``other_basins_pct``: probability of the alternative solutions, %.
        - ``band_inside_50`` etc.: share of the record in which the method's band contains the displacement.
    """
    groups: dict[object, list[int]] = {}
    for i, estimate in enumerate(estimates):
        if estimate.status is Status.OK:
            groups.setdefault(_form(estimate, i), []).append(i)
    columns: Columns = {}
    for members in groups.values():
        group = [estimates[i] for i in members], [problems[i] for i in members], [truths[i] for i in members]
        for name, values in _columns(*group).items():
            columns.setdefault(name, np.full(len(estimates), np.nan))[members] = values
    return columns


def _form(estimate: Estimate, replicate: int) -> object:
    """Return a key that is equal for estimates of the same form; samples and alternatives are scored one by one."""
    distribution = estimate.distribution
    if not isinstance(distribution, Normal) or estimate.alternatives:
        return replicate
    form = (
        distribution.names,
        np.shape(distribution.mean),
        distribution.log,
        distribution.covariance is None,
        distribution.dof is None,
    )
    positive = distribution.log or bool(np.all(distribution.mean > 0))
    curves = len(estimate.reconstructions), len(estimate.bands)
    return form, positive, estimate.parameters is None, estimate.initial_states is None, curves


def _joint(estimates: Sequence[Estimate]) -> Estimate:
    """Stack estimates of the same form into one, whose arrays have the replicate as their first axis."""
    first = estimates[0]
    if first.alternatives:
        return first
    distributions: list[Any] = [estimate.distribution for estimate in estimates]
    names = ("mean", "covariance", "dof") if isinstance(distributions[0], Normal) else ("samples",)
    arrays = {name: [getattr(item, name) for item in distributions] for name in names}
    distribution = replace(
        distributions[0], **{name: None if a[0] is None else np.stack(a) for name, a in arrays.items()}
    )
    return Estimate(first.system, **{"groups" if first.parameters is None else "parameters": distribution})


def _columns(estimates: Sequence[Estimate], problems: Sequence[Problem], truths: Sequence[Truth]) -> Columns:
    """Score estimates of the same form."""
    system, joint = problems[0].system, _joint(estimates)
    true = {name: np.array([truth.parameters[name] for truth in truths]) for name in system.names}
    columns: Columns = {}
    for quantity in system.quantities:
        marginal = joint.marginal(quantity)
        if marginal is not None:
            columns |= _quantity_scores(quantity, marginal, quantity.value(true))
    if joint.alternatives:
        columns["other_basins_pct"] = np.array([100.0 * (1.0 - joint.weight)])
    columns |= _simulated_scores(estimates, problems, truths, point_parameters(joint))
    if estimates[0].reconstructions:
        columns |= _reconstruction_scores(estimates, truths, getattr(joint.distribution, "dof", None))
    return columns


def _quantity_scores(quantity: Quantity, marginal: Marginal, true: np.ndarray) -> Columns:
    name, ratio = quantity.name, marginal.value / true
    columns = {f"{name}_error_pct": 100.0 * np.abs(ratio - 1.0), f"{name}_ratio": ratio}
    if marginal.ppf is None or marginal.cdf is None:
        return columns
    columns[f"{name}_pit"] = marginal.cdf(true)
    for level in LEVELS:
        pieces = marginal.intervals(level)
        inside = np.any([(low <= true) & (true <= high) for low, high in pieces], axis=0)
        columns[f"{name}_coverage_{round(100 * level)}"] = inside.astype(float)
    columns[f"{name}_interval_score_pct"] = 100.0 * interval_score(pieces, true, LEVELS[-1]) / true
    columns[f"{name}_crps_pct"] = 100.0 * crps(marginal.ppf(QUANTILES), true) / true
    return columns


def interval_score(pieces: Sequence[tuple[Any, Any]], true: np.ndarray, level: float) -> np.ndarray:
    """Compute the interval score: width plus ``2/alpha`` times the distance of the true value from the interval.

    T. Gneiting, A. E. Raftery, J. Am. Stat. Assoc. 102:359, 2007, eq. 43. For an interval in several pieces, the width
    is that of all pieces, and the distance that to the nearest piece.

    Args:
        pieces: Lower and upper ends of each piece, each (n,).
        true: True values, (n,).
        level: Nominal level of the interval.
    """
    widths = np.sum([high - low for low, high in pieces], axis=0)
    misses = [np.maximum(low - true, 0.0) + np.maximum(true - high, 0.0) for low, high in pieces]
    return np.asarray(widths + 2.0 / (1.0 - level) * np.min(misses, axis=0))


def crps(quantiles: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Compute the continuous ranked probability score from quantiles.

    It is twice the mean quantile (pinball) score over the levels (T. Gneiting, R. Ranjan, J. Bus. Econ. Stat. 29:411,
    2011).

    Args:
        quantiles: Quantiles at the levels :data:`QUANTILES`, (..., n).
        true: True values, (...).
    """
    true = np.expand_dims(true, -1)
    return np.asarray(2.0 * np.mean((quantiles - true) * ((true < quantiles) - QUANTILES), axis=-1))


def point_parameters(estimate: Estimate) -> Mapping[str, Any] | None:
    """Return parameter values for a simulation.

    Groups are converted with a mass of 1, since the free response does not depend on the scale.
    """
    if estimate.parameters is not None:
        return estimate.parameters.values()
    if estimate.groups is None:
        return None
    system = estimate.system
    p: dict[str, Any] = dict.fromkeys(system.names, 1.0)
    for name, value in estimate.groups.values().items():
        numerator = next(n for n, power in system.quantity(name).exponents.items() if power > 0)
        p[numerator] = value
    return p


def _simulated_scores(
    estimates: Sequence[Estimate], problems: Sequence[Problem], truths: Sequence[Truth], p: Mapping[str, Any] | None
) -> Columns:
    """Score the simulated response at the estimated parameters, during the record and after it."""
    if p is None:
        return {}
    system, records = problems[0].system, [problem.records[0] for problem in problems]
    p = {name: np.broadcast_to(value, len(records)) for name, value in p.items()}
    initial_states = [
        estimate.initial_states[0]
        if estimate.initial_states
        else fit_initial_state(system, {name: float(value[i]) for name, value in p.items()}, record)
        for i, (estimate, record) in enumerate(zip(estimates, records, strict=True))
    ]
    rig, forces = records[0].rig(system), [record.forces for record in records]
    response, continuation = displacements(
        rig, p, initial_states, [truths[0].dense_times, truths[0].forecast_times], forces
    )
    simulated = _rms(truths, response, [truth.dense_displacement for truth in truths])
    forecast = _rms(truths, continuation, [truth.forecast_displacement for truth in truths])
    return {"rmse_simulated": simulated, "rmse_forecast": forecast, "rmse": simulated}


def _reconstruction_scores(estimates: Sequence[Estimate], truths: Sequence[Truth], dof: Any) -> Columns:
    """Score the displacement that the method reconstructed, and its band if it has one."""
    dense = [truth.dense_displacement for truth in truths]
    reconstruction = np.stack(
        [e.reconstructions[0](truth.dense_times) for e, truth in zip(estimates, truths, strict=True)]
    )
    columns = {"rmse": _rms(truths, reconstruction, dense)}
    if not estimates[0].bands:
        return columns
    deviation = np.abs(truths[0].scored(reconstruction - np.stack(dense)))
    bands = [estimate.bands[0](truth.dense_times) for estimate, truth in zip(estimates, truths, strict=True)]
    for level in LEVELS:
        half = np.reshape(standard_quantile(0.5 + level / 2, dof), (-1, 1, 1)) * truths[0].scored(np.stack(bands))
        columns[f"band_inside_{round(100 * level)}"] = np.mean(deviation <= half, axis=(-2, -1))
    return columns


def _rms(truths: Sequence[Truth], paths: np.ndarray, true: Sequence[np.ndarray]) -> np.ndarray:
    """Compute root mean square errors (n,) of displacements (n, n_dof, n_times); infinite where not finite."""
    shared = all(path is true[0] for path in true)
    error = truths[0].scored(paths - (true[0] if shared else np.stack(true)))
    with np.errstate(over="ignore", invalid="ignore"):
        values = np.sqrt(np.mean(np.square(error).reshape(len(error), -1), axis=1))
    return np.where(np.isfinite(values), values, np.inf)
