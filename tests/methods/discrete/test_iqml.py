"""IQML: exact data, the likelihood that SciPy maximises, the bound, its covariance, its refusals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from bench import Channel, Estimate, Normal, Problem, Record, Status
from bench.information.fisher import compute_bound
from bench.scenario.scenario import Scenario
from bench.scenario.truth import closed_form
from bench.systems import SDOF
from methods.discrete.iqml import IQML, whitened

PLANT = {"m": 1.3, "c": 0.6, "k": 9.0}  # a plant that is in no table
TRUE = np.array([PLANT["k"] / PLANT["m"], PLANT["c"] / PLANT["m"]])
TIMES = np.linspace(0.0, 10.0, 25)


def record(values: np.ndarray, times: np.ndarray = TIMES, offset: bool = False) -> Problem:
    return Problem(SDOF(), (Record((Channel(times, values, offset=offset),)),))


def fit(problem: Problem, **settings: int) -> Estimate:
    return IQML(**settings).identify(problem, np.random.default_rng(0))


def groups(problem: Problem) -> Normal:
    estimate = fit(problem)
    assert estimate.groups is not None, estimate.message
    return estimate.groups


def maximum_likelihood(y: np.ndarray, times: np.ndarray, offset: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """k/m and c/m of least misfit from the true start, and their standard errors by SciPy's Jacobian."""

    def misfit(theta: np.ndarray) -> np.ndarray:
        x = closed_form({"m": 1.0, "c": theta[1], "k": theta[0]}, theta[2], theta[3], times)
        return np.asarray(x + (theta[4] if offset else 0.0) - y)

    computed = least_squares(misfit, [*TRUE, 0.8, 0.5, *([y.mean()] if offset else [])], xtol=1e-12, ftol=1e-12)
    variance = 2.0 * computed.cost / (y.size - computed.x.size)
    return computed.x[:2], np.sqrt(variance * np.diag(np.linalg.inv(computed.jac.T @ computed.jac)))[:2]


def test_the_weight_is_that_of_the_difference_equations_noise() -> None:
    a, rows = np.array([1.2, -0.8]), 6
    matrix = np.zeros((rows, rows + 2))
    for i in range(rows):
        matrix[i, i : i + 3] = [-a[1], -a[0], 1.0]
    columns = np.random.default_rng(0).standard_normal((rows, 3))
    np.testing.assert_allclose(whitened(a, columns), np.linalg.solve(matrix @ matrix.T, columns), rtol=1e-10)


@pytest.mark.parametrize("offset", [False, True])
@pytest.mark.parametrize("samples", [25, 150])
def test_it_ends_at_the_maximum_of_the_likelihood(samples: int, offset: bool) -> None:
    """To a fifth of a standard error (it holds its weight while it minimises), where ``ar`` is off by several; its
    standard errors are those of SciPy's Jacobian.
    """
    times = np.linspace(0.0, 10.0, samples)
    noise = 0.02 * np.random.default_rng(6).standard_normal(samples)
    y = closed_form(PLANT, 0.8, 0.5, times) + noise + 0.4 * offset
    computed = groups(record(y, times, offset))
    expected, errors = maximum_likelihood(y, times, offset)
    assert np.all(np.abs(computed.mean - expected) < 0.2 * errors), (computed.mean - expected) / errors
    np.testing.assert_allclose(np.sqrt(np.diag(computed.covariance)), errors, rtol=0.05)
    assert computed.dof == samples - 4 - offset


@pytest.mark.parametrize("snr", [40.0, 20.0, 10.0])
def test_it_is_at_the_bound_of_the_unknown_start(snr: float) -> None:
    """Root mean square error over the bound: within what 100 replicates allow of 1. And 95 % intervals hold."""
    scenario = Scenario("sdof", PLANT, ((0.8,), (0.5,)), snr, initial_state="unknown")
    bound = compute_bound(scenario).relative_sd
    problems = [p for p, _ in scenario.replicates(5, 100)]
    fits = IQML().identify_many(problems, [np.random.default_rng(i) for i in range(100)])
    computed = np.array([fit.groups.mean for fit in fits if fit.groups is not None])
    assert len(computed) == 100
    excess = np.sqrt(np.mean((computed / TRUE - 1) ** 2, axis=0)) / [bound["k_over_m"], bound["c_over_m"]]
    assert np.all(excess > 0.8), excess
    assert np.all(excess < 1.2), excess
    for quantity, true in zip(SDOF().groups, TRUE, strict=True):
        marginals = [fit.marginal(quantity) for fit in fits]
        intervals = np.array([m.interval(0.95) for m in marginals if m is not None])
        assert 0.87 <= np.mean((intervals[:, 0] < true) & (true < intervals[:, 1])) <= 1.0


def test_one_round_is_not_settled() -> None:
    y = closed_form(PLANT, 0.8, 0.5, TIMES) + 0.05 * np.random.default_rng(1).standard_normal(25)
    assert fit(record(y), rounds=1).status is Status.DIVERGED
