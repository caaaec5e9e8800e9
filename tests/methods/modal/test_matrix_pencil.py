"""Matrix pencil: exact data, Prony's closed form, ERA of another library, its covariance and the bound."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import stdtrit

from bench import Channel, Estimate, Normal, Problem, Record
from bench.information.fisher import compute_bound
from bench.scenario.scenario import Scenario
from bench.scenario.truth import closed_form
from bench.systems import SDOF
from methods.modal.matrix_pencil import MatrixPencil, groups_from_poles, poles
from methods.modal.perturbation import group_slopes, pole, second_singular

PLANT = {"m": 1.3, "c": 0.6, "k": 9.0}  # a plant that is in no table
TIMES = np.linspace(0.0, 10.0, 25)


# the measured values of MGH17 (NIST Statistical Reference Datasets), every 10 from 0
def record(p: dict[str, float], times: np.ndarray = TIMES, noise: float = 0.0) -> Problem:
    values = closed_form(p, 0.8, 0.5, times) + noise * np.random.default_rng(4).standard_normal(times.size)
    return Problem(SDOF(), (Record((Channel(times, values),)),))


def fit(problem: Problem, **settings: float) -> Estimate:
    return MatrixPencil(**settings).identify(problem, np.random.default_rng(0))


def groups(problem: Problem, **settings: float) -> Normal:
    estimate = fit(problem, **settings)
    assert estimate.groups is not None, estimate.message
    return estimate.groups


def test_four_samples_are_pronys() -> None:
    """Four values of two exponentials obey ``y_{j+2} + a y_{j+1} + b y_j = 0``: two equations for a and b, whose roots
    are the poles. With noise too, since four values are always two exponentials.
    """
    y = np.array([1.0, 0.2, -0.7, -0.35])
    a, b = np.linalg.solve([[y[1], y[0]], [y[2], y[1]]], [-y[2], -y[3]])
    expected = np.sort_complex(np.roots([1.0, a, b]))
    np.testing.assert_allclose(np.sort_complex(poles(y[None], 0.5)[0]), expected, rtol=1e-10)


def test_it_comes_near_the_bound_of_the_unknown_start() -> None:
    """Root mean square error over the bound at 20 dB: not below what 100 replicates allow, not far above."""
    scenario = Scenario("sdof", PLANT, ((0.8,), (0.5,)), 20.0, initial_state="unknown")
    bound = compute_bound(scenario).relative_sd
    computed = np.array([groups(p, bootstrap=0).mean for p, _ in scenario.replicates(5, 100)])
    truth = np.array([PLANT["k"] / PLANT["m"], PLANT["c"] / PLANT["m"]])
    excess = np.sqrt(np.mean((computed / truth - 1) ** 2, axis=0)) / [bound["k_over_m"], bound["c_over_m"]]
    assert np.all(excess > 0.8), excess
    assert np.all(excess < 1.5), excess


@pytest.mark.parametrize("index", [0, 6, 16, 24])
def test_slopes_of_the_poles_are_those_of_the_estimator(index: int) -> None:
    """Central differences of the whole estimator, decomposition and all, by one sample after the other."""
    y, step, length = closed_form(PLANT, 0.8, 0.5, TIMES), TIMES[1], 8
    true = np.array([[PLANT["k"] / PLANT["m"], PLANT["c"] / PLANT["m"]]])
    moved = np.stack([y + sign * 1e-6 * (np.arange(25) == index) for sign in (1, -1)])
    high, low = groups_from_poles(poles(moved, 1 / 3), step)
    computed = group_slopes(true, y[None], step, length)[0, :, index]
    np.testing.assert_allclose(computed, (high - low) / 2e-6, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("length", [2, 8, 20])
def test_the_second_singular_value_is_that_of_the_hankel_matrix(length: int) -> None:
    z = pole(np.array([[PLANT["k"] / PLANT["m"], PLANT["c"] / PLANT["m"]]]), TIMES[1])
    amplitude = np.array([0.3 - 0.8j])
    y = 2.0 * (amplitude * z ** np.arange(25)).real
    expected = np.linalg.svd(np.lib.stride_tricks.sliding_window_view(y, length + 1), compute_uv=False)[1]
    np.testing.assert_allclose(second_singular(z, amplitude, 25, length), expected, rtol=1e-9)


def test_first_order_covariance_is_the_bootstrap_s(monkeypatch: pytest.MonkeyPatch) -> None:
    """At small noise, and with it the correlation: 4000 records tell a standard deviation to 1 %."""
    problem = record(PLANT, noise=0.02)
    first_order = groups(problem, bootstrap=4000).covariance
    monkeypatch.setattr("methods.modal.perturbation.SMALL", 0.0)
    drawn = groups(problem, bootstrap=4000).covariance
    sds, expected = np.sqrt(np.diag(first_order)), np.sqrt(np.diag(drawn))
    np.testing.assert_allclose(sds, expected, rtol=0.05)
    np.testing.assert_allclose(first_order[0, 1] / np.prod(sds), drawn[0, 1] / np.prod(expected), atol=0.06)


@pytest.mark.parametrize("ratio", [0.9, 0.999, 1.001, 1.1, 1.3, 4.0])
def test_above_critical_damping_two_real_poles_give_the_groups(ratio: float) -> None:
    """From two decays of known rates: ``s² + (c/m) s + k/m`` has the product k/m and the sum -c/m of its roots."""
    root = np.sqrt(complex(ratio**2 - 1.0))
    rates = 3.0 * np.array([-ratio - root, -ratio + root])
    times = np.linspace(0.0, 2.0, 25)
    amplitude = np.array([1.0, 1.0]) if ratio < 1 else np.array([-0.4, 1.4])
    y = (np.exp(rates * times[:, None]) @ amplitude).real
    computed = groups(Problem(SDOF(), (Record((Channel(times, y),)),))).mean
    np.testing.assert_allclose(computed, [9.0, 6.0 * ratio], rtol=1e-5)


@pytest.mark.parametrize("ratio", [1.0, 1.3])
def test_intervals_of_an_overdamped_mass_cover(ratio: float) -> None:
    """Of 60 intervals of 95 % some 57 hold the truth; binomially fewer than 51 or a coverage by width is a fault."""
    plant = {"m": 2.0, "c": 2.0 * ratio * np.sqrt(60.0), "k": 30.0}
    scenario = Scenario("sdof", plant, ((1.0,), (0.0,)), 40.0, initial_state="unknown", duration=4.0, samples=50)
    bound = compute_bound(scenario).relative_sd
    fits = [groups(problem, bootstrap=100) for problem, _ in scenario.replicates(31, 60)]
    truth = np.array([15.0, plant["c"] / 2.0])
    sds = np.array([np.sqrt(np.diag(f.covariance)) for f in fits if f.covariance is not None])
    assert len(sds) == 60
    inside = np.abs(np.array([f.mean for f in fits]) - truth) <= stdtrit(50 - 4, 0.975) * sds
    assert np.all(np.sum(inside, axis=0) >= 51), np.sum(inside, axis=0)
    assert np.all(np.median(sds, axis=0) / truth < 1.5 * np.array([bound["k_over_m"], bound["c_over_m"]]))
