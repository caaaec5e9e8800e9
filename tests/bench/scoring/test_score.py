"""Scores of one replicate: by hand, or against the closed forms of Gneiting and Raftery."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy import stats

from bench import Channel, Draws, Estimate, InitialState, Normal, Problem, Record, Status
from bench.scenario.scenario import Scenario
from bench.scenario.truth import Truth, closed_form
from bench.scoring.score import QUANTILES, crps, interval_score, score, scores
from bench.systems import SDOF

P = {"m": 2.0, "c": 0.5, "k": 18.0}
NAMES = ("m", "c", "k")
START = InitialState(np.array([0.7]), np.array([0.2]))
DENSE, LATER = np.linspace(0, 4, 50), np.linspace(4.1, 8, 50)


def a_pair(told: bool = True) -> tuple[Problem, Truth]:
    """A noise-free record of a known system, and its truth, both from the closed form."""
    times = np.linspace(0, 4, 12)
    record = Record((Channel(times, closed_form(P, 0.7, 0.2, times)),), initial_state=START if told else None)
    dense, later = (closed_form(P, 0.7, 0.2, t)[None] for t in (DENSE, LATER))
    return Problem(SDOF(), (record,)), Truth(P, START, DENSE, dense, LATER, later, (0.0,), math.inf, 0.0)


def an_estimate(factor: float = 1.0, sd: float = 0.1, **more: object) -> Estimate:
    logs = np.log([P[name] for name in NAMES]) + np.log([factor, 1.0, factor])
    return Estimate(SDOF(), parameters=Normal(NAMES, logs, sd**2 * np.eye(3), log=True), **more)


@pytest.mark.parametrize(("centre", "sd"), [(0.0, 1.0), (3.0, 0.5), (-1.0, 2.0), (1.0, 0.05)])
def test_crps_is_that_of_a_normal_distribution(centre: float, sd: float) -> None:
    """``s (z (2Φ(z) - 1) + 2φ(z) - 1/√π)`` at z = (y - mean)/s (Gneiting et al., Mon. Weather Rev. 133:1098, 2005)."""
    y = 0.9
    z = (y - centre) / sd
    exact = sd * (z * (2 * stats.norm.cdf(z) - 1) + 2 * stats.norm.pdf(z) - 1 / math.sqrt(math.pi))
    assert crps(stats.norm(centre, sd).ppf(QUANTILES), y) == pytest.approx(exact, rel=2e-3, abs=2e-3 * sd)


def test_the_interval_score_by_hand() -> None:
    assert interval_score([(1.0, 3.0)], 2.0, 0.95) == pytest.approx(2.0)
    assert interval_score([(1.0, 3.0)], 0.5, 0.95) == pytest.approx(2.0 + 40 * 0.5)
    assert interval_score([(1.0, 3.0)], 3.1, 0.80) == pytest.approx(2.0 + 10 * 0.1)


def test_an_alternative_that_holds_the_truth_is_scored() -> None:
    """The answer's stiffness is four times too low, the other one right: as PIT the mixture's level, 0.6 + 0.4 / 2."""
    right = an_estimate(weight=0.6)
    wrong = an_estimate()
    logs = wrong.parameters.mean + np.log([1.0, 1.0, 0.25])
    low = Estimate(SDOF(), parameters=Normal(NAMES, logs, 0.01**2 * np.eye(3), log=True), weight=0.6)
    estimate = replace(low, alternatives=(replace(right, weight=0.4),))
    columns = score(estimate, *a_pair())
    assert columns["k_coverage_95"] == 1.0
    assert columns["k_pit"] == pytest.approx(0.6 + 0.4 / 2)
    assert columns["k_error_pct"] == pytest.approx(75.0)
    assert columns["other_basins_pct"] == pytest.approx(40.0)
    assert score(low, *a_pair())["k_coverage_95"] == 0.0


def test_a_perfect_estimate_scores_perfectly() -> None:
    scores = score(an_estimate(), *a_pair())
    for quantity in SDOF().quantities:
        assert scores[f"{quantity.name}_error_pct"] == pytest.approx(0.0, abs=1e-10)
        assert scores[f"{quantity.name}_coverage_50"] == 1.0
    for name in ("rmse", "rmse_simulated", "rmse_forecast"):
        assert scores[name] == pytest.approx(0.0, abs=1e-12)


def test_errors_and_scores_by_hand_when_m_and_k_are_half_too_large() -> None:
    """m and k 1.5 times too large: k/m right, c/m a third too small; the log-interval of m misses its truth."""
    scores = score(an_estimate(1.5, 0.1), *a_pair())
    assert scores["m_error_pct"] == pytest.approx(50.0)
    assert scores["k_over_m_error_pct"] == pytest.approx(0.0, abs=1e-9)
    assert scores["c_over_m_error_pct"] == pytest.approx(100 / 3)
    assert scores["damping_ratio_error_pct"] == pytest.approx(100 / 3)
    assert [scores[f"m_coverage_{level}"] for level in (50, 80, 95)] == [0.0, 0.0, 0.0]
    low, high = (1.5 * math.exp(side * 1.959964 * 0.1) for side in (-1, 1))
    assert scores["m_interval_score_pct"] == pytest.approx(100 * (high - low + 40 * (low - 1.0)), rel=1e-6)
    response = closed_form({"m": 3.0, "c": 0.5, "k": 27.0}, 0.7, 0.2, DENSE) - closed_form(P, 0.7, 0.2, DENSE)
    assert scores["rmse_simulated"] == pytest.approx(np.sqrt(np.mean(response**2)), rel=1e-9)
    assert scores["rmse"] == scores["rmse_simulated"]


@pytest.mark.parametrize("side", [0.1, -0.1], ids=["above", "below"])
def test_coverage_at_each_level_is_where_the_truth_stands_in_the_distribution(side: float) -> None:
    """log m is off by one standard deviation, which is the 68 % interval: in at 80 and 95, out at 50."""
    scores = score(an_estimate(math.exp(side), 0.1), *a_pair())
    assert [scores[f"m_coverage_{level}"] for level in (50, 80, 95)] == [0.0, 1.0, 1.0]


@dataclass(frozen=True)
class Shifted:
    """The true displacement plus a constant, or nonsense."""

    constant: float

    def __call__(self, times: np.ndarray) -> np.ndarray:
        return closed_form(P, 0.7, 0.2, times)[None] + self.constant


def test_an_own_reconstruction_is_scored_apart_from_the_simulated_response() -> None:
    scores = score(an_estimate(reconstructions=(Shifted(0.1),)), *a_pair())
    assert scores["rmse"] == pytest.approx(0.1)
    assert scores["rmse_simulated"] == pytest.approx(0.0, abs=1e-12)
    assert score(an_estimate(reconstructions=(Shifted(math.nan),)), *a_pair())["rmse"] == math.inf


def test_an_unknown_start_is_fitted_unless_the_method_has_its_own() -> None:
    assert score(an_estimate(), *a_pair(told=False))["rmse_simulated"] == pytest.approx(0.0, abs=1e-9)
    wrong = an_estimate(initial_states=(InitialState(np.array([0.9]), np.array([0.2])),))
    expected = closed_form(P, 0.2, 0.0, DENSE)  # the response is linear in the start
    found = score(wrong, *a_pair(told=False))["rmse_simulated"]
    assert found == pytest.approx(np.sqrt(np.mean(expected**2)))


def test_groups_alone_have_no_mass_score_but_a_response() -> None:
    groups = Normal(("k_over_m", "c_over_m"), np.array([9.0, 0.25]), None, log=False)
    scores = score(Estimate(SDOF(), groups=groups), *a_pair())
    assert "m_error_pct" not in scores
    assert "k_over_m_coverage_95" not in scores  # no covariance, no interval
    assert scores["k_over_m_error_pct"] == pytest.approx(0.0, abs=1e-12)
    assert scores["rmse"] == pytest.approx(0.0, abs=1e-12)


def test_a_response_that_diverges_is_an_infinite_error() -> None:
    groups = Normal(("k_over_m", "c_over_m"), np.array([9.0, -500.0]), None, log=False)
    scores = score(Estimate(SDOF(), groups=groups), *a_pair())
    assert scores["rmse_forecast"] == math.inf


def test_the_level_at_the_truth_is_the_beliefs_distribution_function() -> None:
    """log m off by one standard deviation; draws of which three in ten lie below the truth."""
    assert score(an_estimate(math.exp(0.1), 0.1), *a_pair())["m_pit"] == pytest.approx(stats.norm.cdf(-1.0))
    draws = np.column_stack([np.linspace(1.4, 3.35, 10), np.full(10, 0.5), np.full(10, 18.0)])
    truth = a_pair()[1].parameters["m"]
    below = float(np.mean(draws[:, 0] < truth))
    pit = score(Estimate(SDOF(), parameters=Draws(NAMES, draws)), *a_pair())["m_pit"]
    assert pit == pytest.approx((10 * below + 0.5) / 11)


@dataclass(frozen=True)
class Constant:
    """The same standard deviation at all times."""

    value: float

    def __call__(self, times: np.ndarray) -> np.ndarray:
        return np.full((1, times.size), self.value)


def test_the_share_inside_the_band() -> None:
    """Off by 0.1 m everywhere: inside 1.96 and 1.28 standard deviations of 0.08 m, outside 0.67 of them."""
    scores = score(an_estimate(reconstructions=(Shifted(0.1),), bands=(Constant(0.08),)), *a_pair())
    assert [scores[f"band_inside_{level}"] for level in (50, 80, 95)] == [0.0, 1.0, 1.0]
    assert "band_inside_95" not in score(an_estimate(reconstructions=(Shifted(0.1),)), *a_pair())


def test_the_rmse_of_two_degrees_of_freedom_is_over_both(reference: Scenario) -> None:
    truth = {"m1": 1.0, "m2": 1.0, "c1": 0.1, "c2": 0.1, "k1": 9.0, "k2": 5.0}
    chain = replace(
        reference, system="chain", parameters=truth, initial=((1.0, 0.0), (0.0, 0.0)), options={"n": 2}, prior=None
    )
    problem, true = chain.replicates(0, 1)[0]

    @dataclass(frozen=True)
    class Off:
        def __call__(self, times: np.ndarray) -> np.ndarray:
            return true.dense_displacement + np.array([[0.3], [0.0]])

    names = tuple(truth)
    distribution = Normal(names, np.log(list(truth.values())), None, log=True)
    scores = score(Estimate(problem.system, parameters=distribution, reconstructions=(Off(),)), problem, true)
    assert scores["rmse"] == pytest.approx(math.sqrt(0.5 * 0.09))
    assert scores["rmse_simulated"] == pytest.approx(0.0, abs=1e-9)


def test_replicates_scored_together_have_the_scores_of_students_t_each() -> None:
    """Log m of 40 replicates, each with its mean, width and degrees of freedom, of scipy's t; draws and a failure among
    them, which have their own scores or none."""
    rng, n = np.random.default_rng(3), 40
    means, sds, dofs = rng.normal(np.log(P["m"]), 0.2, n), rng.uniform(0.05, 0.3, n), rng.integers(2, 30, n)
    logs = np.column_stack([means, np.full(n, np.log(P["c"])), np.full(n, np.log(P["k"]))])
    estimates = [
        Estimate(SDOF(), parameters=Normal(NAMES, logs[i], sds[i] ** 2 * np.eye(3), log=True, dof=float(dofs[i])))
        for i in range(n)
    ]
    estimates.insert(5, Estimate.failed(SDOF(), Status.DIVERGED, "no"))
    estimates.insert(9, Estimate(SDOF(), parameters=Draws(NAMES, np.tile(list(P.values()), (7, 1)))))
    columns = scores(estimates, [a_pair()[0]] * (n + 2), [a_pair()[1]] * (n + 2))
    rows = [{name: values[i] for name, values in columns.items()} for i in range(n + 2)]
    assert rows.pop(9)["m_pit"] == pytest.approx(0.5 / 8)
    assert np.all(np.isnan(list(rows.pop(5).values())))
    for row, mean, sd, dof in zip(rows, means, sds, dofs, strict=True):
        distribution = stats.t(dof, mean, sd)
        assert row["m_pit"] == pytest.approx(distribution.cdf(np.log(P["m"])), rel=1e-9)
        assert row["m_error_pct"] == pytest.approx(100 * abs(np.exp(mean) / P["m"] - 1), rel=1e-9)
        for level in (0.5, 0.8, 0.95):
            low, high = np.exp(distribution.interval(level))
            assert row[f"m_coverage_{round(100 * level)}"] == float(low <= P["m"] <= high)
        miss = max(low - P["m"], 0) + max(P["m"] - high, 0)
        assert row["m_interval_score_pct"] == pytest.approx(100 * (high - low + 40 * miss) / P["m"], rel=1e-9)
        quantiles = np.exp(distribution.ppf(QUANTILES))  # the energy form: E|X - y| - E|X - X'|/2 over these quantiles
        spread = np.mean(np.abs(quantiles[:, None] - quantiles)) / 2
        energy = np.mean(np.abs(quantiles - P["m"])) - spread
        assert row["m_crps_pct"] == pytest.approx(100 * energy / P["m"], rel=1e-9)
