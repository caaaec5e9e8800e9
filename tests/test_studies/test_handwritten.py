"""The fit by hand: its equations, that it solves an easy problem, and the time limit of all."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest

from bench import Estimate, Problem, Status
from bench.config.experiment import expand
from bench.scenario.scenario import Scenario
from tests.studies.handwritten import attempt, by_hand, chain_rates, duffing_rates


def scenario(system: str, snr: float) -> Scenario:
    return expand(["method=prior", f"system={system}", f"snr={snr}", "prior=handbook"], False)[0].scenario


def test_the_equations_are_those_of_a_chain() -> None:
    """Two masses 1 m apart from rest: the springs pull by hand-computed forces. m = 2, 4; k = 3, 5; c = 0.5, 0.25.

    x = (1, 3), v = (1, -1): force in link 1 is 3 + 0.5 = 3.5, in link 2 is 5·2 - 0.25·2 = 9.5.
    """
    p = np.array([2.0, 4.0, 0.5, 0.25, 3.0, 5.0])
    rates = chain_rates(0.0, np.array([1.0, 3.0, 1.0, -1.0]), p)
    assert np.allclose(rates, [1.0, -1.0, (9.5 - 3.5) / 2.0, -9.5 / 4.0])
    assert np.allclose(duffing_rates(0.0, np.array([2.0, 1.0]), np.array([2.0, 1.0, 3.0, 0.5])), [1.0, -5.5])


@pytest.mark.parametrize("system", ["duffing", pytest.param("chain2", marks=pytest.mark.slow)])
def test_it_finds_the_ratios_from_near_by(system: str) -> None:
    """Almost without noise, from handbook values: every ratio to the first mass to a thousandth."""
    cell = scenario(system, 100)
    problem, truth = cell.replicates(3, 1)[0]
    estimate = by_hand(problem, np.random.default_rng(0))
    assert estimate.status is Status.OK
    for group in problem.system.groups:
        found = group.value(estimate.parameters.values())
        assert found == pytest.approx(group.value(truth.parameters), rel=1e-3), group.name


def test_a_fit_that_takes_too_long_is_stopped_and_counts_as_failed() -> None:
    problem, truth = scenario("duffing", 20).replicates(0, 1)[0]

    def endless(problem: Problem, rng: np.random.Generator) -> Estimate:
        while time.process_time() < math.inf:
            pass
        raise AssertionError

    outcome = attempt(endless, problem, truth, np.random.default_rng(0), 1.0, 0.2)
    assert not outcome.success
    assert "0.2 s" in outcome.reason


def test_success_needs_convergence_and_a_small_error() -> None:
    problem, truth = scenario("duffing", 20).replicates(0, 1)[0]

    def nominal(problem: Problem, rng: np.random.Generator) -> Estimate:
        from bench.contract.distribution import Normal

        return Estimate(problem.system, parameters=Normal(problem.prior.names, problem.prior.log_mean, None, True))

    def gives_up(problem: Problem, rng: np.random.Generator) -> Estimate:
        return Estimate.failed(problem.system, Status.DIVERGED, "no")

    rng = np.random.default_rng(0)
    loose, tight = (attempt(nominal, problem, truth, rng, bound, 60.0) for bound in (1e3, 1e-6))
    assert loose.success
    assert not tight.success
    assert tight.reason == "another minimum"
    assert attempt(gives_up, problem, truth, rng, 1.0, 60.0).excess == math.inf
