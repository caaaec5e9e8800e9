"""SRIVC: exact data, the likelihood that SciPy maximises, the bound, filters by quadrature, offsets, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import least_squares

from bench import Channel, Estimate, Force, InitialState, InputError, Problem, Record, Status
from bench.information.fisher import compute_bound
from bench.scenario.force import ForceSpec
from bench.scenario.scenario import Scenario
from bench.scenario.truth import closed_form, matrix_exponential_response
from bench.systems import SDOF
from methods.regression.srivc import SRIVC, Model

PLANT = {"m": 1.3, "c": 0.6, "k": 9.0}  # a plant that is in no table
TIMES = np.linspace(0.0, 10.0, 40)
KNOTS = np.linspace(0.0, 10.0, 101)
START = InitialState(np.array([0.4]), np.array([-0.3]))


def force(hold: str = "linear") -> Force:
    values = 2.0 * np.sin(1.7 * KNOTS) + np.cos(3.1 * KNOTS + 1.0)
    return Force(KNOTS, values, hold)


def record(
    noise: float = 0.0, hold: str = "linear", known: bool = True, offset: float = 0.0, times: np.ndarray = TIMES
) -> Problem:
    clean = matrix_exponential_response(SDOF(), PLANT, START, times, (force(hold),))[0]
    values = clean + offset + noise * np.random.default_rng(4).standard_normal(times.size)
    channel = Channel(times, values, offset=offset != 0.0)
    return Problem(SDOF(), (Record((channel,), (force(hold),), START if known else None),))


def fit(problem: Problem, **settings: int) -> Estimate:
    return SRIVC(**settings).identify(problem, np.random.default_rng(0))


def values(problem: Problem) -> dict[str, float]:
    estimate = fit(problem)
    assert estimate.status is Status.OK, estimate.message
    distribution = estimate.parameters or estimate.groups
    return distribution.values()


@pytest.mark.parametrize("hold", ["zero_order", "linear", "cubic"])
@pytest.mark.parametrize("known", [True, False])
def test_exact_samples_give_the_parameters(hold: str, known: bool) -> None:
    """Whatever the hold: the samples of y are filtered through a spline, and the answer does not depend on it."""
    computed = values(record(hold=hold, known=known))
    np.testing.assert_allclose([computed[name] for name in "mck"], [1.3, 0.6, 9.0], rtol=1e-5)


def test_uneven_times_and_an_offset() -> None:
    times = np.sort(np.random.default_rng(3).uniform(0.3, 9.8, 40))
    estimate = fit(record(offset=0.7, times=times, known=False))
    computed = estimate.parameters.values()
    np.testing.assert_allclose([computed[name] for name in "mck"], [1.3, 0.6, 9.0], rtol=1e-5)
    assert estimate.offsets == pytest.approx((0.7,), rel=1e-5)
    np.testing.assert_allclose(estimate.initial_states[0].displacement, START.displacement, rtol=1e-4)
    np.testing.assert_allclose(estimate.initial_states[0].velocity, START.velocity, rtol=1e-4)


@pytest.mark.parametrize("p", [PLANT, {"m": 1.0, "c": 9.0, "k": 9.0}])
@pytest.mark.parametrize("known", [True, False])
def test_a_free_decay_gives_the_groups(p: dict[str, float], known: bool) -> None:
    start = InitialState(np.array([0.8]), np.array([0.5])) if known else None
    problem = Problem(SDOF(), (Record((Channel(TIMES, closed_form(p, 0.8, 0.5, TIMES)),), (), start),))
    computed = values(problem)
    np.testing.assert_allclose(computed["k_over_m"], p["k"] / p["m"], rtol=1e-5)
    np.testing.assert_allclose(computed["c_over_m"], p["c"] / p["m"], rtol=1e-5)


@pytest.mark.parametrize("known", [True, False])
def test_it_ends_at_the_maximum_of_the_likelihood(known: bool) -> None:
    """SciPy's least squares on the matrix exponential's response: the same point and the same standard errors."""
    problem = record(noise=0.05, known=known)
    y = problem.records[0].channels[0].values

    def misfit(theta: np.ndarray) -> np.ndarray:
        p = dict(zip("mck", map(float, np.exp(theta[:3])), strict=True))
        start = START if known else InitialState(theta[3:4], theta[4:5])
        return np.asarray(matrix_exponential_response(SDOF(), p, start, TIMES, (force(),))[0] - y)

    begin = [*np.log([PLANT[name] for name in "mck"]), *([] if known else [0.4, -0.3])]
    best = least_squares(misfit, begin, xtol=1e-10, ftol=1e-12, x_scale="jac")
    variance = 2.0 * best.cost / (y.size - best.x.size)
    errors = np.sqrt(variance * np.diag(np.linalg.inv(best.jac.T @ best.jac)))[:3]
    parameters = fit(problem).parameters
    assert np.all(np.abs(parameters.mean - best.x[:3]) < 0.02 * errors)
    np.testing.assert_allclose(np.sqrt(np.diag(parameters.covariance)), errors, rtol=0.01)
    assert parameters.dof == 40 - (3 if known else 5)


def test_the_filter_is_the_convolution_with_the_impulse_response() -> None:
    """Of the force at unit mass, by quadrature: the column of 1/m."""
    damping, stiffness, point = 0.6 / 1.3, 9.0 / 1.3, 25
    theta = np.array([damping, stiffness, 1.0 / 1.3])
    column = Model(record(known=True)).equations(theta).instruments[:, 2]
    w = np.sqrt(stiffness - 0.25 * damping**2)

    def product(s: float) -> float:
        past = TIMES[point] - s
        return float(np.exp(-0.5 * damping * past) * np.sin(w * past) / w * force()(np.array([s]))[0])

    inside = KNOTS[(KNOTS > 0) & (TIMES[point] > KNOTS)]
    expected = quad(product, 0.0, TIMES[point], points=inside, limit=400)[0]
    assert column[point] == pytest.approx(expected, rel=1e-7)


@pytest.mark.slow
def test_it_is_at_the_bound() -> None:
    """Root mean square error over the bound at 20 dB, 40 replicates; 95 % intervals hold; the answer is near."""
    spec = ForceSpec(amplitude=2.0, low_hz=0.1, high_hz=0.8, tones=7, samples=101)
    scenario = Scenario("sdof", PLANT, ((0.2,), (0.1,)), 20.0, samples=30, force=spec, initial_state="unknown")
    bound = compute_bound(scenario, 5).relative_sd
    fits = [fit(problem) for problem, _ in scenario.replicates(5, 40)]
    for quantity in (SDOF().quantity(name) for name in "mck"):
        marginals = [marginal for first in fits if (marginal := first.marginal(quantity)) is not None]
        assert len(marginals) == 40
        true = PLANT[quantity.name]
        error = np.sqrt(np.mean([(marginal.value / true - 1.0) ** 2 for marginal in marginals]))
        assert 0.7 < error / bound[quantity.name] < 1.35
        intervals = np.array([marginal.interval(0.95) for marginal in marginals])
        assert np.mean((intervals[:, 0] < true) & (true < intervals[:, 1])) >= 0.85


def test_noise_alone_is_not_trusted() -> None:
    """Of a record without the force's response: a sentence, or intervals as wide as the answer."""
    for seed in range(4):
        noise = np.random.default_rng(seed).standard_normal(40)
        estimate = fit(Problem(SDOF(), (Record((Channel(TIMES, noise),), (force(),)),)))
        assert estimate.status is not Status.OK or "unreliable" in estimate.message


def test_what_it_cannot_take_is_said() -> None:
    short = record(times=TIMES[:4], known=False)
    assert "more than 5 samples" in (SRIVC().objection(short) or "")
    assert fit(record(noise=0.3), rounds=1).status is Status.DIVERGED
    with pytest.raises(InputError, match="rounds"):
        SRIVC(rounds=0)
