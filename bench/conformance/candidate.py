"""A method under check, with the answers that several checks look at, each made once."""

from __future__ import annotations

import copy
import threading
import time
from dataclasses import fields, is_dataclass
from functools import cached_property
from typing import Any

import numpy as np

from bench.conformance.check import Refusal
from bench.conformance.problems import problem
from bench.conformance.surroundings import Surroundings
from bench.contract.estimate import Estimate, Status
from bench.contract.method import Identifier
from bench.contract.prior import Prior
from bench.contract.problem import Problem
from bench.scoring.combination import combine_with_prior

GROUPS = ("k_over_m", "c_over_m")
TIMES = np.linspace(0.0, 8.0, 9)
"""Where reconstructions are compared (s)."""


def stream(seed: int = 11) -> np.random.Generator:
    """A random stream."""
    return np.random.default_rng(seed)


class Candidate:
    """A method under check. ``first`` is its first fit of the ordinary problem, which took ``first_s``;
    ``running``: the threads that were there before it."""

    def __init__(self, method: Identifier) -> None:
        self.method = method
        self.first_s = float("nan")
        self.running = {thread.name for thread in threading.enumerate()}

    def fit(self, given: Problem | None = None, seed: int = 11) -> Estimate:
        """The answer to a problem, by default the ordinary one made anew."""
        return self.method.identify(problem() if given is None else given, stream(seed))

    @cached_property
    def first(self) -> Estimate:
        began = time.perf_counter()
        found = self.fit()
        self.first_s = time.perf_counter() - began
        return answered(found)

    @cached_property
    def start_untold(self) -> Estimate:
        """The answer where the initial state is not told."""
        return answered(self.fit(problem(start=False)))

    @cached_property
    def elsewhere(self) -> tuple[Estimate, Surroundings]:
        """A second fit of the same problem and seed, after another problem, among things that must not matter.

        With it what was seen of the method on the way.
        """
        _ = self.first
        self.fit(problem(seed=2), seed=2)
        given = problem()
        before = copy.deepcopy(given)
        surroundings = self.surroundings(1)
        found = surroundings.fit(self.fit, given)
        changed = difference(before, given)
        if changed:
            surroundings.changes.append(changed)
        return found, surroundings

    def surroundings(self, which: int) -> Surroundings:
        """Decoys to be laid around a fit, and a watch on this method."""
        return Surroundings(type(self.method).__module__.partition(".")[0], which)

    def differs(self, other: Estimate) -> str:
        """How an answer differs from the first, or nothing."""
        return difference_of_answers(self.first, other)


def answered(estimate: Estimate) -> Estimate:
    """The estimate, if it is an answer of the form of the contract; raises Refusal."""
    if not isinstance(estimate, Estimate):
        raise Refusal(f"estimate returned a {type(estimate).__name__}", "return a bench.Estimate")
    if estimate.status is not Status.OK:
        raise Refusal(f"no answer to ordinary data: {estimate.status}, {estimate.message}")
    belief = estimate.belief
    if belief is None or (estimate.parameters is not None and estimate.groups is not None):
        raise Refusal("it gives parameters and groups, or neither")
    known = {quantity.name for quantity in estimate.system.quantities}
    if not set(belief.names) <= known:
        raise Refusal(f"it names {', '.join(sorted(set(belief.names) - known))}; known: {', '.join(sorted(known))}")
    if not belief.finite():
        raise Refusal("its answer is not finite, and its status is ok")
    return estimate


def values(estimate: Estimate, prior: Prior | None) -> tuple[np.ndarray, np.ndarray]:
    """Values of k/m and c/m with their standard errors (half the 68 % interval), shapes (2,)."""
    combined = combine_with_prior(estimate, prior)
    points, errors = [], []
    for name in GROUPS:
        marginal = combined.marginal(combined.system.quantity(name))
        if marginal is None:
            raise Refusal(f"it says nothing of {name}", "name parameters or groups of the problem's system")
        low, high = marginal.interval(0.6827)
        points.append(marginal.value)
        errors.append((high - low) / 2)
    return np.array(points), np.array(errors)


def difference_of_answers(one: Estimate, other: Estimate) -> str:
    """How two answers to the ordinary problem differ in status, values or errors, or nothing."""
    if one.status is not other.status:
        return f"{one.status} became {other.status} ({other.message})"
    if one.status is not Status.OK:
        return ""
    prior = problem().prior
    for first, second in zip(values(one, prior), values(other, prior), strict=True):
        for name, a, b in zip(GROUPS, first, second, strict=True):
            if a != b and not (np.isnan(a) and np.isnan(b)):
                return f"{name} or its error was {a:.9g}, then {b:.9g}"
    return ""


def difference(before: Any, after: Any, name: str = "problem") -> str:
    """The first declared field, below a problem, that is not as it was, or nothing."""
    if isinstance(before, np.ndarray):
        same = np.array_equal(before, after)
        return "" if same else f"{name} was changed"
    if is_dataclass(before) and type(before) is type(after):
        parts = [(f"{name}.{f.name}", getattr(before, f.name), getattr(after, f.name)) for f in fields(before)]
    elif isinstance(before, tuple | list) and isinstance(after, tuple | list) and len(before) == len(after):
        parts = [(f"{name}[{i}]", a, b) for i, (a, b) in enumerate(zip(before, after, strict=True))]
    else:
        return "" if before == after else f"{name} was changed"
    return next((found for own, a, b in parts if (found := difference(a, b, own))), "")
