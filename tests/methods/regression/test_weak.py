"""The weak form: exact motion, its covariance against drawn noise, nearness to the bound, what it cannot take."""

from __future__ import annotations

import numpy as np
import pytest

from bench import Channel, InitialState, Problem, Record, Status
from bench.information.fisher import compute_bound
from bench.scenario.scenario import ForceSpec, Scenario
from bench.systems import SDOF, Duffing
from methods.regression.ls import LS
from methods.regression.weak import WeightFunctions

PLANT = {"m": 1.3, "c": 0.6, "k": 9.0}  # a plant that is in no table
WEAK = LS(derivative="weak", bootstrap=0)


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def test_test_functions_turn_a_cubic_into_its_derivatives() -> None:
    """``∫φ x = x`` for a line at its centre, ``-∫φ' x = ∫φ x'`` and ``∫φ'' x = ∫φ x''`` for a cubic."""
    times = np.linspace(0.0, 3.0, 400)
    motion = WeightFunctions.of(times).motion((times**3)[None, None], np.zeros((1, times.size)))
    speed = WeightFunctions.of(times).motion((3.0 * times**2)[None, None], np.zeros((1, times.size))).x
    np.testing.assert_allclose(motion.v, speed, rtol=1e-7)
    np.testing.assert_allclose(motion.a[0, 0], 6.0 * motion.times, rtol=1e-6)


@pytest.mark.parametrize("forced", [False, True])
def test_exact_motion_gives_the_parameters(forced: bool) -> None:
    force = ForceSpec(3.0, 0.1, 1.0) if forced else None
    scenario = Scenario("sdof", PLANT, ((0.8,), (0.5,)), 140.0, samples=200, force=force)
    estimate = WEAK.identify(scenario.replicates(2, 1)[0][0], rng())
    if forced:
        assert estimate.parameters.values() == pytest.approx(PLANT, rel=1e-3)
    else:
        np.testing.assert_allclose(estimate.groups.mean, [9.0 / 1.3, 0.6 / 1.3], rtol=1e-4)


def test_a_constant_offset_is_no_matter() -> None:
    problem = Scenario("sdof", PLANT, ((0.8,), (0.5,)), 120.0, samples=100).replicates(2, 1)[0][0]
    channel = problem.records[0].channels[0]
    moved = Problem(SDOF(), (Record((Channel(channel.times, channel.values + 0.7, offset=True),)),))
    estimate = WEAK.identify(moved, rng()).groups
    np.testing.assert_allclose(estimate.mean, [9.0 / 1.3, 0.6 / 1.3], rtol=1e-3)


def test_it_comes_near_the_bound_where_differences_do_not() -> None:
    """At 100 samples and 10 dB differences are several times off; the weak form is near the least possible."""
    scenario = Scenario("sdof", PLANT, ((0.8,), (0.5,)), 10.0, initial_state="unknown", samples=100)
    bound = compute_bound(scenario).relative_sd
    problems = [problem for problem, _ in scenario.replicates(5, 40)]
    estimate = [e.groups for e in WEAK.identify_many(problems, [rng() for _ in problems])]
    errors = np.array([g.mean for g in estimate if g is not None]) / [9.0 / 1.3, 0.6 / 1.3] - 1.0
    assert len(errors) == 40
    excess = np.sqrt(np.mean(errors**2, axis=0)) / [bound["k_over_m"], bound["c_over_m"]]
    assert np.all((excess > 0.6) & (excess < 1.6)), excess


def test_a_nonlinear_system_is_declined_in_a_sentence() -> None:
    times = np.linspace(0.0, 6.0, 40)
    start = InitialState(np.array([1.0]), np.array([0.0]))
    problem = Problem(Duffing(), (Record((Channel(times, np.cos(2.0 * times)),), (), start),))
    estimate = WEAK.identify(problem, rng())
    assert estimate.status is Status.UNSUPPORTED
    assert "linear" in estimate.message
