"""Autoregression, at once and recursive: exact data, numpy's solution, its bias in closed form, the way of RLS."""

from __future__ import annotations

import numpy as np
import pytest

from bench import Channel, Estimate, Identifier, InputError, Normal, Problem, Record, Status, Units
from bench.scenario.scenario import Scenario
from bench.scenario.truth import closed_form
from bench.systems import SDOF
from methods.discrete.ar import AR, coefficients_of, groups_of
from methods.discrete.ar_recursive import ARRecursive

PLANT = {"m": 1.3, "c": 0.6, "k": 9.0}  # a plant that is in no table
TIMES = np.linspace(0.0, 10.0, 25)
BOTH = pytest.mark.parametrize("method", [AR(), ARRecursive()], ids=["ar", "ar_recursive"])


def record(values: np.ndarray, times: np.ndarray = TIMES, offset: bool = False) -> Problem:
    return Problem(SDOF(), (Record((Channel(times, values, offset=offset),)),))


def fit(method: Identifier, problem: Problem) -> Estimate:
    return method.identify(problem, np.random.default_rng(0))


def groups(method: Identifier, problem: Problem) -> Normal:
    estimate = fit(method, problem)
    assert estimate.groups is not None, estimate.message
    return estimate.groups


@pytest.mark.parametrize("p", [PLANT, {"m": 1.0, "c": 7.0, "k": 9.0}, {"m": 1.0, "c": 0.2, "k": 50.0}])
@pytest.mark.parametrize("offset", [0.0, 1.5])
def test_exact_samples_give_the_groups(p: dict[str, float], offset: float) -> None:
    """Above critical damping too, and about another level; the recursion to its diffuse start."""
    values = closed_form(p, 0.8, 0.5, TIMES) + offset
    for method, rtol in ((AR(), 1e-6), (ARRecursive(diffuse=1e12), 1e-4)):
        found = groups(method, record(values, offset=offset != 0.0))
        np.testing.assert_allclose(found.mean, [p["k"] / p["m"], p["c"] / p["m"]], rtol=rtol)


def test_it_is_numpys_least_squares() -> None:
    y = closed_form(PLANT, 0.8, 0.5, TIMES) + 0.02 * np.random.default_rng(1).standard_normal(25)
    a = np.linalg.lstsq(np.stack([y[1:-1], y[:-2]], axis=1), y[2:], rcond=None)[0]
    np.testing.assert_allclose(groups(AR(), record(y)).mean, groups_of(a, TIMES[1]), rtol=1e-8)


def test_it_has_the_bias_of_noisy_columns() -> None:
    """Noise of variance v adds ``v I`` to the normal equations' mean and nothing to their right side, whose products
    hold the noise of different samples: ``a - v (XᵀX + v n I)⁻¹ n a`` is the centre for many samples.
    """
    times, noise = np.linspace(0.0, 60.0, 1501), 0.02
    p = {"m": 1.0, "c": 0.05, "k": 9.0}
    x, step = closed_form(p, 1.0, 0.0, times), times[1]
    columns = np.stack([x[1:-1], x[:-2]], axis=1)
    a = np.linalg.solve(columns.T @ columns + 1499 * noise**2 * np.eye(2), columns.T @ x[2:])
    y = x + noise * np.random.default_rng(2).standard_normal((40, 1501))
    found = np.mean([groups(AR(bootstrap=0), record(own, times)).mean for own in y], axis=0)
    expected = groups_of(a, step)
    assert expected[1] > 2.0 * p["c"]
    np.testing.assert_allclose(found, expected, rtol=0.05)
    np.testing.assert_allclose(coefficients_of(expected, step), a, rtol=1e-9)


def test_the_recursion_ends_at_least_squares_and_keeps_its_way() -> None:
    y = closed_form(PLANT, 0.8, 0.5, TIMES) + 0.02 * np.random.default_rng(1).standard_normal(25)
    estimate, units = fit(ARRecursive(), record(y)), Units(length=1e-3, time=0.1)
    assert estimate.groups is not None
    np.testing.assert_allclose(estimate.groups.mean, groups(AR(), record(y)).mean, rtol=1e-4)
    np.testing.assert_allclose(estimate.traces["trajectory"][-1], estimate.groups.mean, rtol=1e-9)
    np.testing.assert_allclose(estimate.traces["trajectory_times"], TIMES[2:])
    # after so many samples it is least squares on those
    early = groups(AR(bootstrap=0), record(y[:15], TIMES[:15])).mean
    np.testing.assert_allclose(estimate.traces["trajectory"][12], early, rtol=1e-3)
    other = fit(ARRecursive(), record(y).expressed_in(units)).expressed_in(units.inverse)
    np.testing.assert_allclose(other.traces["trajectory"][5:], estimate.traces["trajectory"][5:], rtol=1e-6)


@BOTH
def test_the_covariance_is_the_spread_over_replicates(method: Identifier) -> None:
    scenario = Scenario("sdof", PLANT, ((0.8,), (0.5,)), 35.0)
    fits = [groups(method, problem) for problem, _ in scenario.replicates(21, 60)]
    spread = np.std([found.mean for found in fits], axis=0)
    told = np.median([np.sqrt(np.diag(found.covariance)) for found in fits if found.covariance is not None], axis=0)
    np.testing.assert_allclose(told, spread, rtol=0.5)
    assert fits[0].dof == 25 - 4


@BOTH
def test_a_record_without_an_oscillator_is_a_sentence(method: Identifier) -> None:
    estimate = fit(method, record(np.random.default_rng(0).standard_normal(25)))
    assert estimate.status is Status.DIVERGED
    assert "oscillator" in estimate.message


@BOTH
def test_a_response_unlike_the_record_is_said_to_be(method: Identifier) -> None:
    """Of a finely sampled record with noise it makes far too much damping."""
    times = np.linspace(0.0, 6.0, 200)
    y = closed_form(PLANT, 0.8, 0.5, times) + 0.02 * np.random.default_rng(3).standard_normal(200)
    estimate = fit(method, record(y, times))
    doubted = "unexplained" in estimate.message or "do not trust the value" in estimate.message
    assert estimate.status is Status.DIVERGED or doubted


def test_settings_out_of_range_are_refused() -> None:
    for settings in ({"forgetting": 0.0}, {"forgetting": 1.1}, {"diffuse": np.inf}, {"bootstrap": -1}):
        with pytest.raises(InputError, match=next(iter(settings))):
            ARRecursive(**settings)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="bootstrap"):
        AR(bootstrap=-1)
