"""Student t errors: the estimate that SciPy finds for the same likelihood, and what outliers do to it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate, optimize, stats

from bench import OutputError, Problem, Status
from bench.scenario.scenario import PriorSpec, Scenario
from methods.starts.candidates import candidates
from methods.trajectory.student import FEW, STUDENT, student_fits

pytest.importorskip("casadi")
from methods.trajectory.shooting import Shooting

NOMINAL = PriorSpec("nominal", {"mass": 0.02, "damping": 1.0, "stiffness": 0.5, "other": 0.5})
TRUE = {"m": 1.3, "c": 0.6, "k": 9.0}  # a plant that is in no table


def problems(n: int, **changes: object) -> list[Problem]:
    given = {"system": "sdof", "parameters": TRUE, "initial": ((0.8,), (0.5,)), "prior": NOMINAL, **changes}
    return [problem for problem, _ in Scenario(snr_db=20.0, **given).replicates(21, n)]


def struck(problem: Problem, place: int, by: float) -> Problem:
    """The problem with one sample off."""
    record = problem.records[0]
    values = record.channels[0].values.copy()
    values[place] += by
    channel = replace(record.channels[0], values=values)
    return Problem(problem.system, (replace(record, channels=(channel,)),), problem.prior)


def value(method: Shooting, problem: Problem, name: str = "k_over_m") -> tuple[float, float]:
    """Value and half the width of the 68 % interval."""
    estimate = method.identify(problem, np.random.default_rng(0))
    assert estimate.status is Status.OK, estimate.message
    marginal = estimate.marginal(problem.system.quantity(name))
    low, high = marginal.interval(0.6827)
    return marginal.value, (high - low) / 2


def test_information_and_density_are_those_of_scipy_s_t() -> None:
    law = stats.t(STUDENT.dof)
    z = np.linspace(-6.0, 6.0, 7)
    ratio = STUDENT.log_likelihood(z[:, None]) - law.logpdf(z)
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-12)

    x = np.tan(np.linspace(-1.57, 1.57, 200_001))
    density = law.pdf(x)
    score = np.gradient(law.logpdf(x), x)
    location = integrate.trapezoid(score**2 * density, x)
    scale = integrate.trapezoid((1 + x * score) ** 2 * density, x)
    assert STUDENT.location == pytest.approx(location, rel=1e-4)
    assert STUDENT.scale == pytest.approx(scale, rel=1e-3)


def test_the_scale_solves_its_own_equation() -> None:
    """``sum w(r / s) r² = N s²`` by a root finder."""
    model = OutputError(problems(1)[0])
    residuals = np.random.default_rng(4).standard_t(3, model.data.size)

    def excess(s: float) -> float:
        return float(np.sum(5.0 / (4.0 + (residuals / s) ** 2) * residuals**2) - residuals.size * s**2)

    root = optimize.brentq(excess, 1e-3, 10.0, xtol=1e-13)
    assert STUDENT.scales(model, residuals, 0.0)[0] == pytest.approx(root, rel=1e-6)


def test_the_fit_is_the_maximum_that_scipy_finds() -> None:
    given = struck(problems(1)[0], 7, 0.9)
    model = OutputError(given.expressed_in(given.natural_units()))
    fits = student_fits(model, model.vector(candidates(model, 1)[0])[None])
    theta, scale = fits.point.theta[0], fits.sigma[0, 0]

    def minus_log_posterior(vector: np.ndarray) -> float:
        residuals = model.data - model.predict(vector)
        return float(-np.sum(stats.t.logpdf(residuals / scale, STUDENT.dof)) + 0.5 * np.sum(model.penalty(vector) ** 2))

    computed = optimize.minimize(minus_log_posterior, theta + 0.01, method="Nelder-Mead",
                              options={"xatol": 1e-8, "fatol": 1e-12, "maxiter": 4000})  # fmt: skip
    np.testing.assert_allclose(theta, computed.x, atol=2e-5)
    assert fits.settled[0]


def test_a_sample_far_off_moves_normal_errors_only() -> None:
    """An error of a hundred noise levels in one sample: a t answer is where it is without, a normal one far away."""
    for problem in problems(3):
        bad = struck(problem, 9, 6.0)
        clean, sd = value(Shooting(likelihood="student"), problem)
        assert abs(value(Shooting(likelihood="student"), bad)[0] - clean) < sd
        assert abs(value(Shooting(), bad)[0] - clean) > 3 * sd


def test_with_normal_noise_it_costs_little() -> None:
    """Over 24 records the t estimate is as good as the normal one to some percent, and its intervals as honest."""
    given, true = problems(24, samples=40), TRUE["k"] / TRUE["m"]
    normal, student = (np.array([value(method, p) for p in given]) for method in METHODS)
    assert np.std(student[:, 0] - true) < 1.25 * np.std(normal[:, 0] - true)
    assert np.mean(np.abs(student[:, 0] - true) < student[:, 1]) == pytest.approx(0.68, abs=0.25)


METHODS = (Shooting(), Shooting(likelihood="student"))


def test_too_few_samples_are_fitted_with_normal_errors_and_that_is_said() -> None:
    problem = problems(1, samples=5, duration=2.0, initial_state="unknown")[0]
    estimate = Shooting(likelihood="student").identify(problem, np.random.default_rng(0))
    assert FEW in estimate.message
    assert value(Shooting(likelihood="student"), problem) == value(Shooting(), problem)


def test_a_nonlinear_system_is_served() -> None:
    duffing = {"system": "duffing", "parameters": {"m": 1.2, "c": 0.5, "k": 6.0, "k3": 4.0}, "samples": 40}
    bad = struck(problems(1, **duffing)[0], 9, 4.0)
    computed, sd = value(Shooting(likelihood="student"), bad)
    assert abs(computed - 5.0) < 4 * sd
    assert abs(computed - 5.0) < abs(value(Shooting(), bad)[0] - 5.0)
