"""Scores of a training and of a search, by hand, and as methods state them."""

from __future__ import annotations

import numpy as np
import pytest

from bench import Estimate, Identifier, Normal
from bench.config.experiment import expand
from bench.entrants.registry import make_method
from bench.scenario.truth import Truth
from bench.scoring.traces import trace_scores
from bench.systems import SDOF


@pytest.fixture(scope="module")
def truth() -> Truth:
    """Of the reference system: k/m = 8, c/m = 0.4."""
    scenario = expand(["method=prior"], multirun=False)[0].scenario
    return next(iter(scenario.replicates(0, 1)))[1]


def estimate(**traces: np.ndarray) -> Estimate:
    return Estimate(SDOF(), parameters=Normal(("m", "c", "k"), np.zeros(3), None, log=True), traces=traces)


def path(losses: list[float], least: float) -> dict[str, np.ndarray]:
    """Four moments at which k/m is 16, 12, 8.8 and 8.08."""
    parameters = np.array([[1.0, 0.4, 16.0], [1.0, 0.4, 12.0], [1.0, 0.4, 8.8], [2.0, 0.8, 16.16]])
    return {
        "path_cpu_s": np.array([0.015, 0.3, 1.5, 4.0]),
        "path_parameters": parameters,
        "path_loss": np.array(losses),
        "minimum_loss": np.array([least]),
        "minimum_parameters": np.array([1.0, 0.4, 8.4]),
    }


def test_errors_are_those_of_the_last_moment_before(truth: Truth) -> None:
    scores = trace_scores(estimate(**path([9.0, 3.0, 1.5, 1.0], 1.0)), truth)
    assert "k_over_m_off_pct_at_0.01s" not in scores, "nothing is known before the first moment"
    assert scores["k_over_m_off_pct_at_0.02s"] == pytest.approx(100.0)
    assert scores["k_over_m_off_pct_at_0.5s"] == pytest.approx(50.0)
    assert scores["k_over_m_off_pct_at_2s"] == pytest.approx(10.0)
    assert scores["k_over_m_off_pct_at_100s"] == pytest.approx(1.0)
    assert scores["k_over_m_off_pct_at_minimum"] == pytest.approx(5.0)
    assert scores["training_s"] == 4.0


@pytest.mark.parametrize(
    ("losses", "arrival"), [([9.0, 3.0, 1.005, 1.0], 1.5), ([1.0, 3.0, 1.5, 1.0], 4.0), ([1.0, 1.0, 1.0, 1.0], 0.015)]
)
def test_a_training_arrives_where_its_loss_stays_near_the_minimum(
    losses: list[float], arrival: float, truth: Truth
) -> None:
    assert trace_scores(estimate(**path(losses, 1.0)), truth)["arrival_s"] == arrival


def test_starting_points_that_ended_where_the_best_did_are_counted(truth: Truth) -> None:
    ends = np.array([-3.0, 12.0, -2.995, -2.9, -3.0])
    scores = trace_scores(estimate(start_objectives=ends, certificate=np.array([1e-4])), truth)
    assert scores == {"starts": 5.0, "starts_at_best": 3.0, "certificate": 1e-4}


@pytest.mark.parametrize("name", ["shooting", "output_error"])
@pytest.mark.parametrize("system", ["sdof", "pendulum"])
def test_the_end_of_a_search_is_certified_as_a_minimum(name: str, system: str) -> None:
    scenario = expand([f"system={system}", "method=prior", "snr=20"], multirun=False)[0].scenario
    problem, truth = next(iter(scenario.replicates(0, 1)))
    method: Identifier = make_method(name, {})
    scores = trace_scores(method.identify(problem, np.random.default_rng(0)), truth)
    assert scores["starts"] >= scores["starts_at_best"] >= 1.0
    assert scores["certificate"] < 1e-2
