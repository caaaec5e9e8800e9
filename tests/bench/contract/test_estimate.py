"""What a method returns: point values and quantiles of every quantity, in any units, and failures that say so."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from scipy import stats

from bench import Draws, Estimate, InitialState, Normal, SimulatedResponse, Status, Units
from bench.systems import SDOF

LEVELS = np.array([0.025, 0.2, 0.5, 0.9])
COVARIANCE = np.array([[0.04, 0.01, 0.0], [0.01, 0.09, -0.02], [0.0, -0.02, 0.16]])
LOGS = Normal(("m", "c", "k"), np.log([2.0, 0.5, 9.0]), COVARIANCE, log=True)
GROUPS = Normal(("k_over_m", "c_over_m"), np.array([9.0, 0.5]), np.array([[0.25, 0.02], [0.02, 0.01]]), log=False)


def test_log_normal_parameters_and_their_ratio() -> None:
    """log(k/m) is normal with variance var(k) + var(m) - 2 cov(k, m)."""
    estimate = Estimate(SDOF(), parameters=LOGS)
    for name, centre, variance in (
        ("m", 2.0, 0.04),
        ("k_over_m", 4.5, 0.16 + 0.04 - 2 * 0.0),
        ("c_over_m", 0.25, 0.09 + 0.04 - 2 * 0.01),
        ("damping_ratio", 0.5 / (2 * np.sqrt(18.0)), 0.09 + 0.01 + 0.04 - 0.01 + 0.02),
    ):
        marginal = estimate.marginal(SDOF().quantity(name))
        assert marginal.ppf is not None
        assert marginal.value == pytest.approx(centre)
        expected = stats.lognorm(np.sqrt(variance), scale=centre).ppf(LEVELS)
        np.testing.assert_allclose(marginal.ppf(LEVELS), expected, rtol=1e-12)


def test_with_estimated_noise_the_quantiles_are_students() -> None:
    estimate = Estimate(SDOF(), groups=Normal(GROUPS.names, GROUPS.mean, GROUPS.covariance, log=False, dof=4))
    marginal = estimate.marginal(SDOF().quantity("k_over_m"))
    assert marginal.ppf is not None
    np.testing.assert_allclose(marginal.ppf(LEVELS), stats.t(4, 9.0, 0.5).ppf(LEVELS))
    low, high = marginal.interval(0.95)
    assert (low, high) == pytest.approx((9.0 - 2.7764451 * 0.5, 9.0 + 2.7764451 * 0.5))


def test_groups_tell_frequency_and_damping_but_never_the_mass() -> None:
    """The first-order variance of log f = ½ log(k/m) is ¼ var(k/m)/(k/m)²; that of log ζ by the same rule."""
    estimate = Estimate(SDOF(), groups=GROUPS)
    frequency, damping = (estimate.marginal(SDOF().quantity(n)) for n in ("natural_frequency", "damping_ratio"))
    assert frequency.value == pytest.approx(3.0 / (2 * np.pi))
    assert damping.value == pytest.approx(0.5 / (2 * 3.0))
    low, high = frequency.interval(0.95)
    assert np.log(high / low) == pytest.approx(2 * 1.959964 * 0.5 * 0.5 / 9.0, rel=1e-6)
    low, high = damping.interval(0.95)
    gradient = np.array([-0.5 / 9.0, 1 / 0.5])
    sd = np.sqrt(gradient @ GROUPS.covariance @ gradient)
    assert np.log(high / low) == pytest.approx(2 * 1.959964 * sd, rel=1e-6)
    assert estimate.marginal(SDOF().quantity("m")) is None


def test_a_negative_group_has_no_frequency_but_keeps_its_own_value() -> None:
    estimate = Estimate(SDOF(), groups=Normal(GROUPS.names, np.array([9.0, -0.1]), GROUPS.covariance, log=False))
    own = estimate.marginal(SDOF().quantity("c_over_m"))
    assert own.value == -0.1
    assert estimate.marginal(SDOF().quantity("damping_ratio")) is None


def test_draws_give_the_median_and_quantiles_of_products() -> None:
    """The median of a log-normal with mean and variance (mu, s²) of the logarithm is exp(mu), whatever s."""
    rng = np.random.default_rng(0)
    samples = np.exp(rng.multivariate_normal(LOGS.mean, COVARIANCE, 20_000))
    draws = Draws(("m", "c", "k"), samples)
    marginal = Estimate(SDOF(), parameters=draws).marginal(SDOF().quantity("k_over_m"))
    exact = Estimate(SDOF(), parameters=LOGS).marginal(SDOF().quantity("k_over_m"))
    assert marginal.value == pytest.approx(np.exp(np.array([-1.0, 0.0, 1.0]) @ LOGS.mean), rel=0.01)
    assert marginal.interval(0.8) == pytest.approx(exact.interval(0.8), rel=0.02)
    assert draws.values() == pytest.approx(dict(zip("mck", np.exp(LOGS.mean), strict=True)), rel=0.02)


def test_other_units_change_every_number_by_its_dimension() -> None:
    units = Units(2.0, 3.0, 5.0)
    response = SimulatedResponse(SDOF(), LOGS.values(), InitialState(np.array([1.0]), np.array([0.0])))
    starts = (InitialState(np.array([6.0]), np.array([6.0])),)
    estimate = Estimate(SDOF(), parameters=LOGS, reconstructions=(response,), initial_states=starts)
    there = pickle.loads(pickle.dumps(estimate.expressed_in(units)))
    assert there.parameters.values() == pytest.approx({"m": 1.0, "c": 0.5 * 5 / 2, "k": 9.0 * 25 / 2})
    np.testing.assert_array_equal(there.parameters.covariance, COVARIANCE)
    assert there.initial_states[0].displacement[0] == pytest.approx(2.0)
    assert there.initial_states[0].velocity[0] == pytest.approx(10.0)
    times = np.linspace(0, 1, 7)
    np.testing.assert_allclose(there.reconstructions[0](times), response(5.0 * times) / 3.0)

    groups = Estimate(SDOF(), groups=GROUPS).expressed_in(units).groups
    np.testing.assert_allclose(groups.mean, [9.0 * 25, 0.5 * 5])
    np.testing.assert_allclose(groups.covariance[0, 1], GROUPS.covariance[0, 1] * 25 * 5)

    draws = Estimate(SDOF(), parameters=Draws(("m", "c", "k"), np.array([[2.0, 0.5, 9.0]]))).expressed_in(units)
    assert isinstance(draws.parameters, Draws)
    np.testing.assert_allclose(draws.parameters.samples, [[1.0, 1.25, 112.5]])


@pytest.mark.parametrize(
    "estimate",
    [
        Estimate(SDOF()),
        Estimate(SDOF(), groups=Normal(GROUPS.names, np.array([9.0, np.nan]), None, log=False)),
        Estimate(SDOF(), groups=Normal(GROUPS.names, GROUPS.mean, np.full((2, 2), np.inf), log=False)),
        Estimate(SDOF(), parameters=Draws(("m", "c", "k"), np.array([[1.0, np.nan, 1.0]]))),
    ],
    ids=["nothing", "mean", "covariance", "draws"],
)
def test_an_estimate_that_is_not_finite_becomes_a_failure(estimate: Estimate) -> None:
    assert estimate.checked().status is Status.NONFINITE


def a_mixture() -> Estimate:
    """A log-normal stiffness of 9 (70 %) or 40 (30 %), all else as in LOGS."""
    other = Normal(LOGS.names, LOGS.mean + np.log([1.0, 1.0, 40.0 / 9.0]), COVARIANCE / 4, log=True)
    return Estimate(
        SDOF(),
        parameters=LOGS,
        weight=0.7,
        alternatives=(Estimate(SDOF(), parameters=other, weight=0.3),),
    )


def test_the_quantiles_of_an_estimate_with_alternatives_are_those_of_the_mixture() -> None:
    marginal = a_mixture().marginal(SDOF().quantity("k"))
    assert marginal.ppf is not None
    assert marginal.cdf is not None
    parts = stats.lognorm(0.4, scale=9.0), stats.lognorm(0.2, scale=40.0)
    quantiles = marginal.ppf(LEVELS)
    mixture = 0.7 * parts[0].cdf(quantiles) + 0.3 * parts[1].cdf(quantiles)
    np.testing.assert_allclose(mixture, LEVELS, atol=1e-9)
    assert marginal.cdf(20.0) == pytest.approx(0.7 * parts[0].cdf(20.0) + 0.3 * parts[1].cdf(20.0))
    assert marginal.value == pytest.approx(9.0)


def test_the_interval_of_an_estimate_with_alternatives_is_a_union_and_its_hull() -> None:
    marginal = a_mixture().marginal(SDOF().quantity("k"))
    separate, joined = marginal.intervals(0.8), marginal.intervals(0.999999)
    expected = [stats.lognorm(sd, scale=scale).ppf([0.1, 0.9]) for sd, scale in ((0.4, 9.0), (0.2, 40.0))]
    np.testing.assert_allclose(separate, expected)
    assert marginal.interval(0.8) == (separate[0][0], separate[1][1])
    assert len(joined) == 1  # both reach over the gap
    other = a_mixture().expressed_in(Units(2.0, 3.0, 5.0)).marginal(SDOF().quantity("k"))
    np.testing.assert_allclose(
        other.intervals(0.8), np.array(separate) / Units(2.0, 3.0, 5.0).of(SDOF().parameters[2].dimension)
    )
