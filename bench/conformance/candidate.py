"""A method under check: its answers, each computed once, and how two answers are compared."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
import threading
import time
from functools import cached_property

import numpy as np

from bench.conformance.check import Refusal
from bench.conformance.problems import problem
from bench.conformance.watch import Watch
from bench.contract.estimate import Estimate, Status
from bench.contract.method import Identifier
from bench.contract.prior import Prior
from bench.contract.problem import Problem
from bench.scenario.stream import anonymous_stream
from bench.scoring.combination import combine_with_prior
from bench.sweep.scoring_process import data_digest

GROUPS = ("k_over_m", "c_over_m")
SEED = 11
REPLICATES = (5, 2, 3)
"""Seeds of the problems that are solved again in another process, the ordinary one first."""


class Candidate:
    """A method under check. ``first_s`` is the time of its first fit (s), ``threads`` those running before it."""

    def __init__(self, method: Identifier) -> None:
        self.method = method
        self.first_s = float("nan")
        self.threads = {thread.name for thread in threading.enumerate()}

    def fit(self, given: Problem | None = None) -> Estimate:
        """Answer a problem, by default the ordinary one."""
        return self.method.identify(problem() if given is None else given, anonymous_stream(SEED))

    @cached_property
    def first(self) -> Estimate:
        """The first answer to the ordinary problem."""
        began = time.perf_counter()
        estimate = self.fit()
        self.first_s = time.perf_counter() - began
        return valid(estimate)

    @cached_property
    def without_initial_state(self) -> Estimate:
        """The answer where the initial state is unknown."""
        return valid(self.fit(problem(start=False)))

    @cached_property
    def second(self) -> tuple[Estimate, Watch, bool]:
        """The answer after another problem and among decoys, the watch, and whether the data are left."""
        _ = self.first
        self.fit(problem(seed=2))
        watch, given = Watch(), problem()
        before = data_digest(given)
        return watch.fit(self.method, given, SEED), watch, data_digest(given) == before

    @cached_property
    def values_elsewhere(self) -> list[list[float]]:
        """k/m and c/m of the replicates, solved in another process in the reverse order."""
        request = pickle.dumps((self.method, REPLICATES[::-1]))
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        command = [sys.executable, "-c", f"from {__name__} import solve_again; solve_again()"]
        done = subprocess.run(command, input=request, capture_output=True, env=environment, check=False)
        if done.returncode:
            lines = done.stderr.decode(errors="replace").strip().splitlines() or ["no message"]
            raise Refusal(f"another process of it ended with status {done.returncode}: {lines[-1][:200]}")
        answers: list[list[float]] = json.loads(done.stdout)
        return answers[::-1]


def solve_again() -> None:
    """Solve problems in the order that standard input names, and write the values to standard output as JSON."""
    output = os.dup(1)
    os.dup2(2, 1)  # what a method prints must not mix with the answer
    method, seeds = pickle.loads(sys.stdin.buffer.read())
    answers = json.dumps([replicate_values(Candidate(method), seed) for seed in seeds])
    with os.fdopen(output, "w") as file:
        file.write(answers)


def replicate_values(candidate: Candidate, seed: int) -> list[float]:
    """Return k/m and c/m of a replicate, NaN where there is no answer."""
    estimate = candidate.fit(problem(seed=seed))
    if estimate.status is not Status.OK:
        return [float("nan")] * len(GROUPS)
    return [float(value) for value in values(estimate, problem(seed=seed).prior)[0]]


def valid(estimate: Estimate) -> Estimate:
    """Return the estimate, if it is an answer of the form of the contract; raises Refusal."""
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
    """Return k/m and c/m with their standard errors (half the 68 % interval), shapes (2,)."""
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


def difference(one: Estimate, other: Estimate) -> str:
    """Say how two answers to the ordinary problem differ in status, values or errors; nothing where they do not."""
    if one.status is not other.status:
        return f"{one.status} became {other.status} ({other.message})"
    if one.status is not Status.OK:
        return ""
    prior = problem().prior
    before, after = (np.concatenate(values(estimate, prior)) for estimate in (one, other))
    for i in np.flatnonzero((before != after) & ~(np.isnan(before) & np.isnan(after))):
        return f"{GROUPS[i % 2]} or its error was {before[i]:.9g}, then {after[i]:.9g}"
    return ""
