"""Autoregression: numpy's solution, its bias in closed form, the recursion, roots from numpy, slopes by differences."""

from __future__ import annotations

import numpy as np
import pytest

from bench import Channel, Estimate, Identifier, Normal, Problem, Record, Status, Units
from bench.scenario.truth import closed_form
from bench.systems import SDOF
from methods.discrete.ar import AR, coefficient_slopes, coefficients_of, equations, groups_of
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
    computed = np.mean([groups(AR(bootstrap=0), record(part, times)).mean for part in y], axis=0)
    expected = groups_of(a, step)
    assert expected[1] > 2.0 * p["c"]
    np.testing.assert_allclose(computed, expected, rtol=0.05)
    np.testing.assert_allclose(coefficients_of(expected, step), a, rtol=1e-9)


def test_the_recursion_ends_at_least_squares_and_keeps_its_way() -> None:
    y = closed_form(PLANT, 0.8, 0.5, TIMES) + 0.02 * np.random.default_rng(1).standard_normal(25)
    estimate, units = fit(ARRecursive(), record(y)), Units(length=1e-3, time=0.1)
    np.testing.assert_allclose(estimate.groups.mean, groups(AR(), record(y)).mean, rtol=1e-4)
    np.testing.assert_allclose(estimate.traces["trajectory"][-1], estimate.groups.mean, rtol=1e-9)
    np.testing.assert_allclose(estimate.traces["trajectory_times"], TIMES[2:])
    # after so many samples it is least squares on those
    early = groups(AR(bootstrap=0), record(y[:15], TIMES[:15])).mean
    np.testing.assert_allclose(estimate.traces["trajectory"][12], early, rtol=1e-3)
    other = fit(ARRecursive(), record(y).expressed_in(units)).expressed_in(units.inverse)
    np.testing.assert_allclose(other.traces["trajectory"][5:], estimate.traces["trajectory"][5:], rtol=1e-6)


@BOTH
def test_a_response_unlike_the_record_is_said_to_be(method: Identifier) -> None:
    """Of a finely sampled record with noise it makes far too much damping."""
    times = np.linspace(0.0, 6.0, 200)
    y = closed_form(PLANT, 0.8, 0.5, times) + 0.02 * np.random.default_rng(3).standard_normal(200)
    estimate = fit(method, record(y, times))
    doubted = "unexplained" in estimate.message or "unreliable" in estimate.message
    assert estimate.status is Status.DIVERGED or doubted


PLANTS = [
    {"m": 1.3, "c": 0.6, "k": 9.0},
    {"m": 2.0, "c": 1e-6, "k": 5.0},
    {"m": 1.0, "c": 9.0, "k": 9.0},  # two decays without a turn
    {"m": 1.0, "c": 6.0, "k": 9.0},  # critical
]
SHORT = np.linspace(0.0, 6.0, 31)


def ratios(p: dict[str, float]) -> np.ndarray:
    return np.array([p["k"] / p["m"], p["c"] / p["m"]])


@pytest.mark.parametrize("p", PLANTS)
@pytest.mark.parametrize("offset", [False, True])
def test_the_coefficients_carry_exact_samples_on(p: dict[str, float], offset: bool) -> None:
    """Samples of the closed form, an offset among them, obey the equation."""
    a = coefficients_of(ratios(p), SHORT[1])
    x = closed_form(p, 0.8, 0.5, SHORT) + 0.7 * offset
    columns, target = equations(x[None], offset)
    unknowns = np.append(a, [0.7 * (1.0 - a.sum())] * offset)
    np.testing.assert_allclose(columns[0] @ unknowns, target[0], atol=1e-9)


@pytest.mark.parametrize("p", PLANTS[:3])
def test_groups_are_those_of_numpys_roots(p: dict[str, float]) -> None:
    a, step = coefficients_of(ratios(p), 0.2), 0.2
    s = np.log(np.roots([1.0, -a[0], -a[1]]).astype(complex)) / step
    np.testing.assert_allclose(groups_of(a, step), [np.prod(s).real, -np.sum(s).real], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(groups_of(a, step), ratios(p), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("p", PLANTS)
def test_slopes_are_central_differences(p: dict[str, float]) -> None:
    groups, step, small = ratios(p), 0.2, 1e-6
    expected = [
        (coefficients_of(groups + move, step) - coefficients_of(groups - move, step)) / (2 * small)
        for move in small * np.eye(2)
    ]
    np.testing.assert_allclose(coefficient_slopes(groups, step), np.transpose(expected), rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize("roots", [(-0.5, 0.5), (-0.5, -0.4), (1.2, 0.5), (0.0, 0.5)])
def test_roots_of_no_oscillator_have_no_groups(roots: tuple[float, float]) -> None:
    _, minus_a1, minus_a2 = np.poly(roots)
    assert np.all(np.isnan(groups_of(np.array([-minus_a1, -minus_a2]), 0.1)))
