"""What is pooled over the quantities of a system: errors over bounds, coverage, and modes; of one result."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np

from bench.dynamics.modal import Agreement, agreement, modes, modes_of_all
from bench.reporting.frame import ERROR, Result
from bench.scenario.scenario import Scenario
from bench.scoring.summary import wilson_interval

MODAL = {"frequencies_error_pct": "frequency_pct", "damping_ratios_error_pct": "damping_pct", "least_mac": "least_mac"}
"""Metrics that are computed here from the identified parameters, and where they stand in an Agreement."""
FAILED = Agreement(math.inf, math.inf, 0.0)


def pooled_quantities(scenario: Scenario, identifiable: Mapping[str, bool]) -> list[str]:
    """The quantities that the data tell: all parameters, else the groups; where neither is told, all parameters."""
    system = scenario.make_system()
    groups = [group.name for group in system.groups]
    for names in (list(system.names), groups):
        if all(identifiable.get(name, False) for name in names):
            return names
    return [name for name in groups if identifiable.get(name)] or list(system.names)


def pooled_bound(result: Result, names: Sequence[str]) -> float:
    """The root mean square of the quantities' bounds (%)."""
    bounds = [result.bound(name + ERROR) for name in names]
    return math.sqrt(float(np.mean(np.square(bounds)))) if bounds else math.nan


def pooled_errors(result: Result, names: Sequence[str]) -> np.ndarray:
    """By replicate, the root mean square over the quantities of error over bound; infinite where it failed."""
    bounds = np.array([result.bound(name + ERROR) for name in names])
    errors = np.stack([result.errors(name + ERROR) for name in names], axis=1)
    usable = np.isfinite(bounds) & (bounds > 0)
    if not usable.any():
        return np.full(result.n, np.inf)
    with np.errstate(over="ignore"):
        ratios = errors[:, usable] / bounds[usable]
        return np.asarray(np.sqrt(np.mean(ratios**2, axis=1)))


def pooled_excess(result: Result, names: Sequence[str]) -> float:
    """Root mean square of the pooled errors over the successful replicates; NaN without any."""
    errors = pooled_errors(result, names)
    good = errors[np.isfinite(errors) & result.ok]
    return float(np.sqrt(np.mean(good**2))) if good.size else math.nan


def pooled_coverage(result: Result, names: Sequence[str], level: int = 95) -> tuple[float, float, float]:
    """Share of the intervals of these quantities that held the truth, with Wilson's interval over the replicates.

    Intervals of one replicate are not independent of each other: the interval counts replicates, not intervals.
    """
    hits = np.stack([result.scores(f"{name}_coverage_{level}") for name in names])[:, result.ok]
    counts = np.sum(np.isfinite(hits), axis=0)
    shares = np.nansum(hits, axis=0)[counts > 0] / counts[counts > 0]
    if not shares.size:
        return math.nan, math.nan, math.nan
    low, high = wilson_interval(round(sum(shares.tolist())), shares.size)
    return float(np.mean(shares)), low, high


def identified(result: Result) -> dict[str, np.ndarray]:
    """The parameters by replicate (n,), over the gauge mass where a method gives groups only; NaN where it failed."""
    scenario = result.scenario
    system = scenario.make_system()
    direct = {name: scenario.parameters[name] * _ratios(result, name) for name in system.names}
    over_gauge = {system.gauge: np.ones(result.n)}
    for group in system.groups:
        name = next(n for n, power in group.exponents.items() if power > 0)
        over_gauge[name] = _ratios(result, group.name) * float(group.value(scenario.parameters))
    whole = np.all(np.isfinite(list(direct.values())), axis=0)
    missing = np.full(result.n, np.nan)
    found = {name: np.where(whole, own, over_gauge.get(name, missing)) for name, own in direct.items()}
    return {name: np.where(result.ok, own, np.nan) for name, own in found.items()}


def _ratios(result: Result, name: str) -> np.ndarray:
    return result.scores(f"{name}_ratio")


@cache
def modal_scores(result: Result) -> dict[str, np.ndarray]:
    """By metric and replicate, how the identified modes agree with the true ones; nothing for other systems."""
    scenario = result.scenario
    system = scenario.make_system()
    if not system.linear or system.n_dof < 2 or not result.stored:
        return {}
    true, parameters = modes(system, scenario.parameters), identified(result)
    known = np.flatnonzero(np.all(np.isfinite(list(parameters.values())), axis=0))
    found = [FAILED] * result.n
    for i, own in zip(known, modes_of_all(system, {name: p[known] for name, p in parameters.items()}), strict=True):
        found[i] = agreement(own, true)
    return {metric: np.array([getattr(one, key) for one in found]) for metric, key in MODAL.items()}


def lower_median(values: np.ndarray) -> float:
    """The median where values may be infinite: the lower of the middle two."""
    return float(np.sort(values)[(values.size - 1) // 2])
