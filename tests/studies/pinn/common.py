"""Helpers of the parts: a result as a table, and errors over the oracle's."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bench import Identifier, Problem
from bench.entrants.reference import oracle_estimate
from bench.information.fisher import compute_bound
from bench.scenario.scenario import METHOD, Scenario
from bench.scenario.truth import Truth
from bench.scoring.combination import combine_with_prior
from bench.scoring.score import score
from bench.scoring.summary import metric_bounds

SEED = 31337
"""A seed that nothing was tuned on and no table uses."""


@dataclass
class Part:
    """One part's result: a table, what was asked of it, and numbers for a picture."""

    name: str
    title: str
    text: str
    columns: list[str]
    rows: list[list[str]]
    data: dict[str, Any] = field(default_factory=dict)


def root_mean_squares(scores: Sequence[dict[str, float]], names: Sequence[str]) -> np.ndarray:
    """Root mean square of each score over the replicates; infinite where a replicate has none."""
    return np.array([np.sqrt(np.mean([s.get(name, np.inf) ** 2 for s in scores])) for name in names])


def error_names(scenario: Scenario) -> list[str]:
    """The scores that methods are ranked on: displacement and identifiable groups."""
    return ["rmse", *(f"{group.name}_error_pct" for group in scenario.make_system().groups)]


METHODS = ("pinn", "collocation", "shooting")
"""The network, what stands in its place, and maximum likelihood: the methods that are compared."""


@dataclass(frozen=True, eq=False)
class Trials:
    """Data sets of a scenario with their truths, and what the errors of a method on them are held against.

    ``oracle`` and ``bounds`` (n_names,) are root mean square errors; NaN where the oracle was not asked.
    """

    scenario: Scenario
    pairs: list[tuple[Problem, Truth]]
    names: list[str]
    oracle: np.ndarray
    bounds: np.ndarray


def trials(scenario: Scenario, replicates: int, oracle: bool = True) -> Trials:
    """The first ``replicates`` data sets of a scenario, with their bound, and the oracle's errors if asked."""
    pairs, names = scenario.replicates(SEED, replicates), error_names(scenario)
    errors = np.full(len(names), np.nan)
    if oracle:
        errors = root_mean_squares([score(oracle_estimate(*pair), *pair) for pair in pairs], names)
    bounds = metric_bounds(compute_bound(scenario, SEED))
    return Trials(scenario, pairs, names, errors, np.array([bounds[name] for name in names]))


@dataclass
class Comparison:
    """Root mean square errors over the oracle's on the same data and over the bound; median processor seconds a fit.

    ``failed`` fits gave no answer.
    """

    names: list[str]
    over_oracle: np.ndarray
    over_bound: np.ndarray
    seconds: float
    failed: int


def compare(method: Identifier, on: Trials) -> Comparison:
    """Fit the data sets one after the other."""
    own, seconds = [], []
    for i, (problem, truth) in enumerate(on.pairs):
        rng = on.scenario.stream(METHOD, SEED, i)
        started = time.process_time()
        estimate = method.identify(problem, rng)
        seconds.append(time.process_time() - started)
        own.append(score(combine_with_prior(estimate, problem.prior).checked(), problem, truth))
    errors = root_mean_squares(own, on.names)
    failed = sum(not s for s in own)
    return Comparison(on.names, errors / on.oracle, errors / on.bounds, float(np.median(seconds)), failed)
