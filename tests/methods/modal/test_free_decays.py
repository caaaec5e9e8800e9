"""All methods that read the free decay of one mass: exact samples, growth, noise, spread, what they decline."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench import Channel, Estimate, Force, Identifier, InitialState, Normal, Problem, Record, Status
from bench.entrants.registry import make_method
from bench.scenario.scenario import Scenario
from bench.scenario.truth import closed_form
from bench.systems import SDOF, Chain, Duffing
from methods.discrete.ar_recursive import ARRecursive

PLANT = {"m": 1.3, "c": 0.6, "k": 9.0}  # plants that are in no table
UNDAMPED, OVERDAMPED = {"m": 2.0, "c": 1e-6, "k": 5.0}, {"m": 1.0, "c": 9.0, "k": 9.0}
FAST = {"m": 1.0, "c": 0.2, "k": 50.0}
TIMES = np.linspace(0.0, 10.0, 25)
DENSE = np.linspace(0.0, 10.0, 1500)
UNEVEN = np.sort(np.random.default_rng(3).uniform(0.0, 8.0, 25))
BY_POLES = ["ar", "ar_recursive", "iqml", "matrix_pencil", "era"]
EVERY = [*BY_POLES, "log_decrement"]


def record(values: np.ndarray, times: np.ndarray = TIMES, offset: bool = False) -> Problem:
    return Problem(SDOF(), (Record((Channel(times, values, offset=offset),)),))


def fit(name: str, problem: Problem, **settings: float) -> Estimate:
    return make_method(name, settings).identify(problem, np.random.default_rng(0))


def groups(name: str, problem: Problem, **settings: float) -> Normal:
    estimate = fit(name, problem, **settings)
    assert estimate.groups is not None, estimate.message
    return estimate.groups


@pytest.mark.parametrize("p", [PLANT, UNDAMPED, OVERDAMPED, FAST], ids=["damped", "undamped", "overdamped", "fast"])
@pytest.mark.parametrize("offset", [0.0, 2.5])
@pytest.mark.parametrize("name", ["ar", "iqml", "matrix_pencil"])
def test_exact_samples_give_the_groups(name: str, p: dict[str, float], offset: float) -> None:
    """At five samples a cycle and less, where differences have a bias of 11 %, and about another level."""
    times = np.linspace(0.0, 4.0, 25) if p is OVERDAMPED else TIMES
    computed = groups(name, record(closed_form(p, 0.8, 0.5, times) + offset, times, offset != 0.0))
    np.testing.assert_allclose(computed.mean, [p["k"] / p["m"], p["c"] / p["m"]], rtol=1e-5, atol=1e-7)
    assert computed.dof == 25 - 4 - (offset != 0.0)


@pytest.mark.parametrize("offset", [0.0, 1.5])
def test_the_recursion_gives_them_to_its_diffuse_start(offset: float) -> None:
    problem = record(closed_form(PLANT, 0.8, 0.5, TIMES) + offset, offset=offset != 0.0)
    estimate = ARRecursive(diffuse=1e12).identify(problem, np.random.default_rng(0))
    np.testing.assert_allclose(estimate.groups.mean, [9.0 / 1.3, 0.6 / 1.3], rtol=1e-4)


@pytest.mark.parametrize("p", [PLANT, {"m": 2.0, "c": 0.05, "k": 5.0}, {"m": 1.0, "c": 1.2, "k": 30.0}])
@pytest.mark.parametrize("uneven", [False, True])
def test_the_decrement_of_a_dense_exact_record(p: dict[str, float], uneven: bool) -> None:
    """Parabola and straight line over steps h err by parts of (ωh)², which is below 2e-3 here (ω below 5.5 rad/s)."""
    times = DENSE.copy()
    if uneven:
        times[1:-1] += np.random.default_rng(2).uniform(-0.3, 0.3, 1498) * times[1]
    computed = groups("log_decrement", record(closed_form(p, 0.8, 0.5, times), times)).mean
    np.testing.assert_allclose(computed, [p["k"] / p["m"], p["c"] / p["m"]], rtol=2e-3)


@pytest.mark.parametrize("name", EVERY)
def test_a_growing_vibration_is_given_as_it_is_and_said_to_grow(name: str) -> None:
    times, rtol = (DENSE, 2e-3) if name == "log_decrement" else (TIMES, 1e-3 if name == "ar_recursive" else 1e-6)
    estimate = fit(name, record(np.exp(0.1 * times) * np.cos(3.0 * times), times))
    np.testing.assert_allclose(estimate.groups.mean, [9.01, -0.2], rtol=rtol)
    assert "negative" in estimate.message


@pytest.mark.parametrize("name", ["ar", "ar_recursive", "matrix_pencil"])
def test_the_covariance_is_the_spread_over_replicates(name: str) -> None:
    scenario = Scenario("sdof", PLANT, ((0.8,), (0.5,)), 20.0 if name == "matrix_pencil" else 35.0)
    fits = [groups(name, problem) for problem, _ in scenario.replicates(21, 60)]
    spread = np.std([computed.mean for computed in fits], axis=0)
    sds = np.median(
        [np.sqrt(np.diag(computed.covariance)) for computed in fits if computed.covariance is not None], axis=0
    )
    np.testing.assert_allclose(sds, spread, rtol=0.5)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", ["ar", "ar_recursive", "iqml"])
def test_noise_alone_is_not_trusted(name: str, seed: int) -> None:
    estimate = fit(name, record(np.random.default_rng(seed).standard_normal(60), np.linspace(0.0, 10.0, 60)))
    assert estimate.status is Status.DIVERGED or "unreliable" in estimate.message


@pytest.mark.parametrize("name", ["matrix_pencil", "era"])
def test_a_sign_that_alternates_is_a_sentence(name: str) -> None:
    """The alternating part of ``0.9^j + (-0.5)^j`` belongs to no mass on a spring."""
    j = np.arange(25)
    estimate = fit(name, record(0.9**j + (-0.5) ** j, 0.1 * j))
    assert estimate.status is Status.DIVERGED
    assert "poles" in estimate.message


@pytest.mark.parametrize("name", EVERY)
def test_the_initial_state_is_not_used(name: str) -> None:
    problem = record(closed_form(PLANT, 0.8, 0.5, TIMES) + 0.02 * np.random.default_rng(1).standard_normal(25))
    known = replace(problem.records[0], initial_state=InitialState(np.array([7.0]), np.array([-3.0])))
    here, there = groups(name, problem), groups(name, replace(problem, records=(known,)))
    np.testing.assert_array_equal(here.mean, there.mean)
    np.testing.assert_array_equal(here.covariance, there.covariance)


@pytest.mark.parametrize("name", EVERY)
def test_no_bootstrap_no_uncertainty(name: str) -> None:
    problem = record(closed_form(PLANT, 0.8, 0.5, TIMES) + 0.02 * np.random.default_rng(1).standard_normal(25))
    assert groups(name, problem, bootstrap=0).covariance is None


@pytest.mark.parametrize("name", BY_POLES)
def test_uneven_and_too_few_samples_are_declined_in_a_sentence(name: str) -> None:
    method: Identifier = make_method(name, {})
    uneven = record(closed_form(PLANT, 0.8, 0.5, UNEVEN), UNEVEN)
    assert "even" in (method.objection(uneven) or "")
    assert fit(name, uneven).status is Status.UNSUPPORTED
    values = closed_form(PLANT, 0.8, 0.5, TIMES)
    assert "5" in (method.objection(record(values[:4], TIMES[:4])) or "")
    assert method.objection(record(values[:5], TIMES[:5])) is None
    # times printed to a ten-thousandth are even enough
    assert method.objection(record(values, np.round(TIMES, 4))) is None


@pytest.mark.parametrize("name", ["matrix_pencil", "era"])
def test_too_many_samples_are_declined_in_a_sentence(name: str) -> None:
    times = np.linspace(0.0, 10.0, 700)
    assert "decimate" in (make_method(name, {}).objection(record(np.cos(3.0 * times), times)) or "")


@pytest.mark.parametrize("name", EVERY)
def test_other_problems_are_declined_in_a_sentence(name: str) -> None:
    channel, method = Channel(TIMES, np.cos(TIMES)), make_method(name, {})
    declined = {
        "force": Problem(SDOF(), (Record((channel,), (Force(TIMES, np.sin(TIMES)),)),)),
        "linear": Problem(Duffing(), (Record((channel,)),)),
        "one record": Problem(SDOF(), (Record((channel,)), Record((channel,)))),
    }
    if name != "era":
        declined["DOF"] = Problem(Chain(2), (Record((channel,)),))
        declined["channel"] = Problem(Chain(2), (Record((channel, Channel(TIMES, np.cos(TIMES), dof=1))),))
    for word, problem in declined.items():
        assert word in (method.objection(problem) or ""), word
