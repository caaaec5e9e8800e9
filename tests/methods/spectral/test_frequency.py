"""Frequency domain: the model beside exact solutions and quadrature, the fit beside least squares in time."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import approx_fprime, least_squares

from bench import Channel, Estimate, Force, InitialState, Normal, Prior, Problem, Record, Status
from bench.contract.problem import Hold
from bench.scenario.truth import closed_form, matrix_exponential_response
from bench.systems import SDOF
from methods.spectral.fit import Objective
from methods.spectral.frequency import Frequency
from methods.spectral.lines import HarmonicLayout, force_harmonics, forced_lines, real_lines, transient

PLANT = {"m": 1.3, "c": 0.6, "k": 9.0}  # a plant that is in no table
TIMES = np.linspace(0.0, 9.0, 28)
HOLDS: tuple[Hold, ...] = ("zero_order", "linear", "cubic")


def push(hold: Hold) -> Force:
    """A rough force whose samples fall between those of the displacement."""
    times = np.linspace(0.0, 9.0, 41)
    return Force(times, 3.0 * np.random.default_rng(1).standard_normal(41), hold)


def fit(problem: Problem) -> Estimate:
    return Frequency().identify(problem, np.random.default_rng(0))


def free(noise: float = 0.0, offset: float = 0.0) -> Problem:
    values = closed_form(PLANT, 0.8, 0.5, TIMES) + noise * np.random.default_rng(4).standard_normal(TIMES.size) + offset
    return Problem(SDOF(), (Record((Channel(TIMES, values, offset=bool(offset)),)),))


def forced(hold: Hold, noise: float = 0.0, prior: Prior | None = None) -> Problem:
    force, start = push(hold), InitialState(np.array([0.2]), np.array([-0.3]))
    clean = matrix_exponential_response(SDOF(), PLANT, start, TIMES, (force,))[0]
    values = clean + noise * np.random.default_rng(4).standard_normal(TIMES.size)
    return Problem(SDOF(), (Record((Channel(TIMES, values),), (force,)),), prior)


def groups(estimate: Estimate) -> Normal:
    assert estimate.groups is not None, estimate.message
    return estimate.groups


def logs(estimate: Estimate) -> Normal:
    assert isinstance(estimate.parameters, Normal), estimate.message
    return estimate.parameters


@pytest.mark.parametrize("samples", [8, 9])
def test_the_real_lines_are_an_orthonormal_transform(samples: int) -> None:
    matrix = real_lines(np.fft.rfft(np.eye(samples), norm="ortho"), samples)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(samples), atol=1e-13)


@pytest.mark.parametrize("c", [0.6, 2 * np.sqrt(9.0 * 1.3), 20.0, -0.2], ids=["light", "critical", "heavy", "growing"])
@pytest.mark.parametrize("samples", [20, 21])
def test_a_free_vibration_is_a_transient_of_two_terms(c: float, samples: int) -> None:
    """Without leakage, and for real poles, a double one and growing ones too."""
    times = np.linspace(0.0, 6.0, samples)
    start = InitialState(np.array([0.8]), np.array([0.5]))
    y = matrix_exponential_response(SDOF(), PLANT | {"c": c}, start, times)[0]
    columns, _ = transient(HarmonicLayout(samples, times[1], np.zeros(0)), 9.0 / 1.3, c / 1.3)
    lines = real_lines(np.fft.rfft(y, norm="ortho"), samples)
    amplitudes = np.linalg.lstsq(columns, lines, rcond=None)[0]
    np.testing.assert_allclose(columns @ amplitudes, lines, atol=1e-8 * np.max(np.abs(lines)))


@pytest.mark.parametrize("hold", HOLDS)
def test_harmonics_of_the_force_are_those_of_quadrature(hold: Hold) -> None:
    force, period = push(hold), 10.0
    computed = force_harmonics((force,), 0.3, 8.9, period, 40)
    for k in (0, 1, 7, 39):
        s = 2 * np.pi * k / period
        breaks = [t for t in force.times if 0.3 < t < 8.9]
        parts = [
            quad(lambda t: float(force(np.array([t]))[0]) * wave(s * (t - 0.3)), 0.3, 8.9, points=breaks, limit=400)[0]  # noqa: B023
            for wave in (np.cos, np.sin)
        ]
        np.testing.assert_allclose(computed[k], (parts[0] - 1j * parts[1]) / period, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("hold", HOLDS)
def test_the_response_to_a_force_is_that_of_the_matrix_exponential(hold: Hold) -> None:
    """Up to a free vibration, which the transient has, and the harmonics left out."""
    problem = forced(hold)
    force, step = problem.records[0].forces, TIMES[1]
    harmonics = force_harmonics(force, 0.0, 9.0, 28 * step, 28 * 40)
    layout = HarmonicLayout(28, step, harmonics)
    left = (
        real_lines(np.fft.rfft(problem.records[0].channels[0].values, norm="ortho"), 28)
        - forced_lines(layout, 1.3, 0.6, 9.0)[0]
    )
    columns, _ = transient(layout, 9.0 / 1.3, 0.6 / 1.3)
    amplitudes = np.linalg.lstsq(columns, left, rcond=None)[0]
    np.testing.assert_allclose(columns @ amplitudes, left, atol=2e-5)


def test_the_gradient_is_that_of_the_sum_of_squares() -> None:
    """Exact in spite of Kaufman's simplification, with a force, an offset and a prior."""
    problem = forced("linear", noise=0.1)
    harmonics = force_harmonics(problem.records[0].forces, 0.0, 9.0, 28 * TIMES[1], 28 * 40)
    lines = real_lines(np.fft.rfft(problem.records[0].channels[0].values, norm="ortho"), 28)
    objective = Objective(HarmonicLayout(28, TIMES[1], harmonics), lines, True, np.zeros(3), np.array([0.5, 1.0, 2.0]))
    point = np.log([1.1, 0.9, 7.0])
    trial = objective.linearise(point[None])
    expected = approx_fprime(point, lambda u: float(objective.linearise(u[None]).cost[0]), 1e-7)
    np.testing.assert_allclose(2 * trial.slopes[0].T @ trial.residuals[0], expected, rtol=1e-4)


@pytest.mark.parametrize("offset", [0.0, 2.5])
def test_exact_samples_give_the_groups_exactly(offset: float) -> None:
    estimate = groups(fit(free(offset=offset)))
    np.testing.assert_allclose(estimate.mean, [9.0 / 1.3, 0.6 / 1.3], rtol=1e-6)
    assert estimate.dof == 28 - 4 - bool(offset)


@pytest.mark.parametrize("hold", HOLDS)
def test_exact_samples_under_a_force_give_mass_damping_and_stiffness(hold: Hold) -> None:
    np.testing.assert_allclose(np.exp(logs(fit(forced(hold))).mean), [1.3, 0.6, 9.0], rtol=1e-4)


def test_it_is_the_least_squares_fit_in_time_with_its_covariance() -> None:
    """The transform is orthonormal, so both have the same minimum; here by scipy on the closed form."""
    problem = free(noise=0.05)
    y = problem.records[0].channels[0].values

    def residuals(u: np.ndarray) -> np.ndarray:
        return closed_form({"m": 1.0, "c": u[1], "k": u[0]}, u[2], u[3], TIMES) - y

    other = least_squares(residuals, [7.0, 0.4, 0.8, 0.5], xtol=1e-12, ftol=1e-12, gtol=1e-12)
    covariance = np.linalg.inv(other.jac.T @ other.jac) * 2 * other.cost / (28 - 4)
    estimate = groups(fit(problem))
    np.testing.assert_allclose(estimate.mean, other.x[:2], rtol=1e-5)
    np.testing.assert_allclose(estimate.covariance, covariance[:2, :2], rtol=1e-3)


def test_a_prior_beside_a_force_is_weighed_by_the_noise() -> None:
    """The maximum of the posterior, found by scipy over the exact response at the noise that its residuals show."""
    prior = Prior({"m": 1.35, "c": 1.2, "k": 8.0}, {"m": 0.02, "c": 1.0, "k": 0.5})
    problem = forced("zero_order", noise=0.2, prior=prior)
    y, force = problem.records[0].channels[0].values, problem.records[0].forces

    def weighed(u: np.ndarray, sigma: float) -> np.ndarray:
        p = dict(zip(("m", "c", "k"), np.exp(u[:3]), strict=True))
        start = InitialState(u[3:4], u[4:])
        modelled = matrix_exponential_response(SDOF(), p, start, TIMES, force)[0]
        return np.concatenate([(modelled - y) / sigma, prior.residuals(u[:3])])

    u, sigma = np.array([*np.log([1.35, 1.0, 9.0]), 0.2, -0.3]), 0.2
    for _ in range(4):
        u = least_squares(weighed, u, args=(sigma,)).x
        sigma = float(np.sqrt(np.sum((weighed(u, 1.0)[:28]) ** 2) / (28 - 5)))
    np.testing.assert_allclose(logs(fit(problem)).mean, u[:3], atol=2e-3)


def test_the_mirror_image_beyond_half_the_sampling_rate_is_not_taken() -> None:
    times = np.linspace(0.0, 9.0, 28)
    p = {"m": 1.0, "c": 0.1, "k": (2 * np.pi * 2.5) ** 2}  # 2.5 Hz at 3 Hz sampling looks like 0.5 Hz
    problem = Problem(SDOF(), (Record((Channel(times, closed_form(p, 0.8, 0.0, times)),)),))
    assert groups(fit(problem)).mean[0] == pytest.approx((2 * np.pi * 0.5) ** 2, rel=1e-2)


def test_uneven_samples_are_declined_with_a_sentence() -> None:
    times = np.sort(np.random.default_rng(3).uniform(0.0, 8.0, 25))
    estimate = fit(Problem(SDOF(), (Record((Channel(times, closed_form(PLANT, 1.0, 0.0, times)),)),)))
    assert estimate.status is Status.UNSUPPORTED
    assert "even steps" in estimate.message


def test_growing_vibration_is_given_and_said() -> None:
    values = closed_form(PLANT, 0.8, 0.5, TIMES)[::-1].copy()
    estimate = fit(Problem(SDOF(), (Record((Channel(TIMES, values),)),)))
    assert groups(estimate).mean[1] == pytest.approx(-0.6 / 1.3, rel=1e-4)
    assert "grows" in estimate.message
