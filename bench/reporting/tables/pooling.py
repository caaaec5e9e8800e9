"""What is pooled over the quantities of a system: errors over bounds, coverage, and modes; of one result."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np

from bench.contract.estimate import Status
from bench.dynamics.modal import Agreement, agreement, modes
from bench.reporting.frame import ERROR, Result
from bench.scenario.scenario import Scenario
from bench.scoring.row import Row
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


def identified(row: Row, scenario: Scenario) -> dict[str, float] | None:
    """The parameters of a replicate; over the gauge mass where its method gives groups only. None where it failed."""
    if row.status is not Status.OK:
        return None
    system = scenario.make_system()
    ratios = {name: row.scores.get(f"{name}_ratio", math.nan) for name in system.names}
    if all(map(math.isfinite, ratios.values())):
        return {name: scenario.parameters[name] * ratio for name, ratio in ratios.items()}
    found = {system.gauge: 1.0}
    for group in system.groups:
        name = next(n for n, power in group.exponents.items() if power > 0)
        found[name] = row.scores.get(f"{group.name}_ratio", math.nan) * float(group.value(scenario.parameters))
    return found if all(name in found for name in system.names) else None


@cache
def modal_scores(result: Result) -> dict[str, np.ndarray]:
    """By metric and replicate, how the identified modes agree with the true ones; nothing for other systems."""
    scenario = result.scenario
    system = scenario.make_system()
    if not system.linear or system.n_dof < 2 or not result.stored:
        return {}
    true = modes(system, scenario.parameters)
    found = []
    for row in result.stored.rows:
        p = identified(row, scenario)
        found.append(FAILED if p is None else agreement(modes(system, p), true))
    return {metric: np.array([getattr(one, key) for one in found]) for metric, key in MODAL.items()}


def lower_median(values: np.ndarray) -> float:
    """The median where values may be infinite: the lower of the middle two."""
    return float(np.sort(values)[(values.size - 1) // 2])
