"""Statistics over several quantities and replicates: errors over bounds, coverage, modes, medians."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np

from bench.dynamics.modal import Modes, agreement, modes, modes_of_all
from bench.reporting.frame import ERROR, Result
from bench.systems import System

MODAL = {
    "frequencies_error_pct": ("frequency_pct", math.inf),
    "damping_ratios_error_pct": ("damping_pct", math.inf),
    "least_mac": ("least_mac", 0.0),
}
"""Metrics of modes: the field of an Agreement, and the value of a failed fit."""


def pooled_quantities(system: System, identifiable: Mapping[str, bool]) -> tuple[str, ...]:
    """Return the identifiable quantities: all parameters, else the groups; without either, all parameters."""
    groups = tuple(group.name for group in system.groups)
    for names in (system.names, groups):
        if all(identifiable.get(name, False) for name in names):
            return names
    return tuple(name for name in groups if identifiable.get(name)) or system.names


def pooled_excess(result: Result, names: Sequence[str]) -> float:
    """Return the root mean square of error over bound, over quantities and successful replicates; NaN without any."""
    bounds = np.array([result.bound(name + ERROR) for name in names])
    errors = np.stack([result.errors(name + ERROR) for name in names], axis=1)[result.ok]
    usable = np.isfinite(bounds) & (bounds > 0)
    if not usable.any():
        return math.nan
    with np.errstate(over="ignore"):
        pooled = np.sqrt(np.mean((errors[:, usable] / bounds[usable]) ** 2, axis=1))
    return root_mean_square(pooled[np.isfinite(pooled)])


def pooled_coverage(result: Result, names: Sequence[str]) -> float:
    """Return the mean over replicates of the coverage of the 95 % intervals of some quantities; NaN without any."""
    hits = np.stack([result.scores(f"{name}_coverage_95") for name in names])[:, result.ok]
    hits = hits[:, np.isfinite(hits).any(axis=0)]
    return float(np.mean(np.nanmean(hits, axis=0))) if hits.size else math.nan


def identified(result: Result) -> dict[str, np.ndarray]:
    """Return the identified parameters by replicate (n,); NaN where the fit failed.

    They are relative to the gauge mass where a method returns groups only.
    """
    scenario = result.scenario
    system = scenario.make_system()
    direct = {name: scenario.parameters[name] * result.scores(f"{name}_ratio") for name in system.names}
    over_gauge = {system.gauge: np.ones(result.n)}
    for group in system.groups:
        name = next(n for n, power in group.exponents.items() if power > 0)
        over_gauge[name] = result.scores(f"{group.name}_ratio") * float(group.value(scenario.parameters))
    whole = np.all(np.isfinite(list(direct.values())), axis=0)
    missing = np.full(result.n, np.nan)
    parameters = {name: np.where(whole, values, over_gauge.get(name, missing)) for name, values in direct.items()}
    return {name: np.where(result.ok, values, np.nan) for name, values in parameters.items()}


@cache
def modal_scores(result: Result) -> dict[str, np.ndarray]:
    """Return the agreement of identified with true modes by metric and replicate (n,); empty without modes."""
    scenario = result.scenario
    system = scenario.make_system()
    if not system.linear or system.n_dof < 2 or not result.stored:
        return {}
    true, parameters = _true_modes(system, tuple(scenario.parameters.items())), identified(result)
    finite = np.all(np.isfinite(list(parameters.values())), axis=0)
    agreed = agreement(modes_of_all(system, {name: p[finite] for name, p in parameters.items()}), true)
    scores = {}
    for metric, (name, failed) in MODAL.items():
        scores[metric] = np.full(result.n, failed)
        scores[metric][finite] = getattr(agreed, name)
    return scores


@cache
def _true_modes(system: System, parameters: tuple[tuple[str, float], ...]) -> Modes:
    return modes(system, dict(parameters))


def lower_median(values: np.ndarray) -> float:
    """Return the median of values that may be infinite, the lower of the middle two; NaN without any."""
    return float(np.sort(values)[(values.size - 1) // 2]) if values.size else math.nan


def root_mean_square(values: np.ndarray) -> float:
    """Return the root mean square; NaN without any value."""
    return float(np.sqrt(np.mean(values**2))) if values.size else math.nan
