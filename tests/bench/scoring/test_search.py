"""Scores of a search from several starts, by hand, and as methods state it."""

from __future__ import annotations

import numpy as np
import pytest

from bench import Estimate, Identifier, Normal, Status
from bench.config.experiment import expand
from bench.entrants.registry import make_method
from bench.scoring.search import search_scores
from bench.systems import SDOF


def estimate(**traces: np.ndarray) -> Estimate:
    return Estimate(SDOF(), parameters=Normal(("m", "c", "k"), np.zeros(3), None, log=True), traces=traces)


def test_starts_that_ended_where_the_best_did_are_counted() -> None:
    ends = np.array([-3.0, 12.0, -2.995, -2.9, -3.0])
    scores = search_scores(estimate(start_objectives=ends, certificate=np.array([1e-4])))
    assert scores == {"starts": 5.0, "starts_at_best": 3.0, "certificate": 1e-4}


def test_without_traces_there_are_no_scores() -> None:
    assert search_scores(estimate()) == {}
    assert search_scores(Estimate.failed(SDOF(), Status.DIVERGED, "no answer")) == {}


@pytest.mark.parametrize("name", ["shooting", "output_error"])
@pytest.mark.parametrize("system", ["sdof", "pendulum"])
def test_the_certificate_is_that_of_a_minimum_only_at_one(name: str, system: str) -> None:
    """The end of a search is certified as one, and the search says where each start ended."""
    scenario = expand([f"system={system}", "method=prior", "snr=20"], multirun=False)[0].scenario
    problem, _ = next(iter(scenario.replicates(0, 1)))
    method: Identifier = make_method(name, {})
    found = search_scores(method.identify(problem, np.random.default_rng(0)))
    assert found["starts"] >= found["starts_at_best"] >= 1.0
    assert found["certificate"] < 1e-2
