"""Silent failures: answers that are given, wrong, and say neither, on scenarios that no table has.

An answer is silently wrong where a quantity's error is beyond five Cramér-Rao bounds and the true value is beyond three
half-widths of every interval that the answer states.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from bench.commands.declaration import OneOf, Within
from bench.contract.estimate import Estimate, Status
from bench.contract.problem import Problem
from bench.entrants.registry import make_method
from bench.information.fisher import compute_bound
from bench.reporting.tables.render import markdown_table
from bench.scenario.disturbance import Irregular
from bench.scenario.scenario import METHOD, PriorSpec, Scenario
from bench.scenario.truth import Truth
from bench.scoring.combination import combine_with_prior
from bench.scoring.statistics import wilson_interval
from tests.studies.common import RESULTS, Count, Out, publish, study, tracked

METHODS = ("shooting", "output_error", "pinn", "collocation", "ekf", "ukf", "frequency", "mcmc")
PRIOR = PriorSpec("nominal", {"mass": 0.02, "damping": 1.0, "stiffness": 0.5, "other": 0.5})
BOUNDS, HALF_WIDTHS = 5.0, 3.0
NYQUIST = "below the Nyquist frequency", "beyond it"
LEAST_SAMPLES = 15


def drawn(seed: int, beyond: bool) -> Scenario:
    """Draw a scenario with 2.5 to 25 samples a cycle, or ``beyond`` the Nyquist frequency with 0.6 to 2."""
    rng = np.random.default_rng([seed, beyond])
    mass, rate = np.exp(rng.uniform(np.log([0.2, 1.0]), np.log([20.0, 60.0])))
    ratio = np.exp(rng.uniform(np.log(0.003), np.log(0.15)))
    a_cycle = rng.uniform(0.6, 2.0) if beyond else np.exp(rng.uniform(np.log(2.5), np.log(25.0)))
    samples = max(LEAST_SAMPLES, round(a_cycle * rng.uniform(3.0, 15.0)))
    parameters = {"m": mass, "c": 2.0 * ratio * rate * mass, "k": mass * rate**2}
    kind = ("duffing", "chain", "sdof", "sdof", "sdof", "sdof")[rng.integers(6)]
    amplitude = np.exp(rng.uniform(np.log(0.001), np.log(1.0)))
    if kind == "duffing":
        parameters["k3"] = rng.uniform(0.1, 0.5) * parameters["k"] / amplitude**2
    if kind == "chain":
        parameters = two_masses(rng, parameters)
    uneven = (None, None, Irregular(size=0.5), Irregular(size=1.0))[rng.integers(4)]
    phase = rng.uniform(0.0, 2.0 * np.pi, 2 if kind == "chain" else 1)
    return Scenario(
        kind,
        {name: float(f"{value:.5g}") for name, value in parameters.items()},
        (tuple(map(float, amplitude * np.cos(phase))), tuple(map(float, amplitude * rate * np.sin(phase)))),
        snr_db=float(rng.uniform(5.0, 40.0)),
        duration=float((samples - 1) * 2.0 * np.pi / rate / a_cycle),
        samples=samples,
        initial_state="unknown" if rng.random() < 0.5 else "known",
        prior=PRIOR,
        disturbance=uneven,
        label="drawn",
    )


def two_masses(rng: np.random.Generator, each: dict[str, float]) -> dict[str, float]:
    """Draw a chain of two masses, each part within a factor of 1.6 of the oscillator's."""
    return {f"{name}{i}": value * np.exp(rng.uniform(-0.5, 0.5)) for name, value in each.items() for i in (1, 2)}


@dataclass
class Tally:
    """Counts of a method's answers in one regime."""

    answers: int = 0
    failed: int = 0
    silent: list[int] = field(default_factory=list)
    covered: int = 0
    intervals: int = 0
    several: int = 0
    widths: list[float] = field(default_factory=list)

    def add(self, number: int, estimate: Estimate, truth: Truth, bounds: dict[str, float]) -> None:
        """Count the answer to the scenario of this number."""
        if estimate.status is not Status.OK:
            self.failed += 1
            return
        self.answers += 1
        self.several += bool(estimate.alternatives)
        wrong = False
        for quantity in estimate.system.groups:
            marginal, true = estimate.marginal(quantity), quantity.value(truth.parameters)
            if marginal is None or marginal.ppf is None:
                continue
            pieces = marginal.intervals(0.95)
            self.intervals += 1
            self.covered += any(low <= true <= high for low, high in pieces)
            self.widths.append(sum(high - low for low, high in pieces) / true)
            near = any(abs(true - (low + high) / 2) <= HALF_WIDTHS * (high - low) / 2 for low, high in pieces)
            wrong |= not near and abs(marginal.value / true - 1.0) > BOUNDS * bounds[quantity.name]
        if wrong:
            self.silent.append(number)


def answer(method: str, problem: Problem, stream: np.random.Generator) -> Estimate:
    """Return the estimate of a method, combined with the prior."""
    return combine_with_prior(make_method(method, {}).identify(problem, stream).checked(), problem.prior).checked()


def silent(
    seed: Annotated[int, Within(ge=0), "seed of the draw, chosen on the day"],
    below: Annotated[Count, "scenarios below the Nyquist frequency"] = 140,
    beyond: Annotated[Count, "scenarios with 0.6 to 2 samples a cycle"] = 60,
    methods: Annotated[tuple[str, ...], OneOf(METHODS), "methods that are tried"] = METHODS,
    out: Out = RESULTS,
) -> int:
    """Count the silent failures of methods on scenarios drawn by a seed."""
    tallies: dict[tuple[str, bool], Tally] = defaultdict(Tally)
    cases = [(i, past) for past, n in ((False, below), (True, beyond)) for i in range(n)]
    for number, past in tracked(cases, "scenario"):
        scenario = drawn(seed + number, past)
        problem, truth = scenario.maker(seed)(0)
        bounds = compute_bound(scenario, seed).relative_sd
        for method in methods:
            estimate = answer(method, problem, scenario.stream(METHOD, seed, 0, number))
            tallies[method, past].add(number, estimate, truth, bounds)
    publish(out / "silent_failures.md", _page(tallies, seed, below, beyond))
    return 0


COLUMNS = (
    "method",
    "sampling",
    "answers",
    "no answer",
    "silently wrong",
    "of scenario",
    "several basins",
    "coverage (%)",
    "median width (%)",
)


def _page(tallies: dict[tuple[str, bool], Tally], seed: int, below: int, beyond: int) -> str:
    rows = []
    for (method, past), tally in sorted(tallies.items(), key=lambda item: item[0][1]):
        low, high = wilson_interval(tally.covered, max(tally.intervals, 1))
        share = tally.covered / max(tally.intervals, 1)
        counts = (tally.answers, tally.failed, len(tally.silent))
        rows.append(
            [
                method,
                NYQUIST[past],
                *map(str, counts),
                " ".join(map(str, tally.silent[:6])),
                str(tally.several),
                f"{100 * share:.1f} [{100 * low:.0f}, {100 * high:.0f}]",
                f"{100 * float(np.median(tally.widths or [np.nan])):.2g}",
            ]
        )
    return f"""# Silent failures

Regenerate: `python -m tests.studies.silent seed={seed} below={below} beyond={beyond}`.

{below} scenarios below the Nyquist frequency (2.5 to 25 samples a cycle) and {beyond} beyond it (0.6 to 2), drawn at
random: one mass, one in six with a cubic spring, and one in six two masses in a chain; initial state known or not; even
samples, or half or wholly irregular ones; 5 to 40 dB; nominal prior. *Silently wrong*: an error beyond {BOUNDS:g}
Cramér-Rao bounds where the true value is beyond {HALF_WIDTHS:g} half-widths of every stated interval, of k/m or c/m.
*Coverage*: of the stated 95 % intervals, a union where the answer has several basins; *width*: of the union, over the
true value.

{markdown_table(rows, COLUMNS)}
"""


if __name__ == "__main__":
    sys.exit(study(silent, "tests.studies.silent"))
