"""Bouc-Wen, whose hysteretic displacement no sensor shows: methods that carry hidden states, and others."""

from __future__ import annotations

import numpy as np
import pytest

from bench import Problem
from bench.config import expand
from bench.registry import make_method, missing_package
from bench.truth import Truth


def record(snr: int) -> tuple[Problem, Truth]:
    """The configured Bouc-Wen oscillator; its truth comes from another integrator than the methods use."""
    override = ["method=prior", "system=bouc_wen", f"snr={snr}"]
    return expand(override, multirun=False)[0].cell().scenario.replicates(17, 1)[0]


@pytest.mark.parametrize(
    ("name", "tolerance"), [("shooting", 0.01), ("output_error", 0.01), ("ekf", 0.01), ("collocation", 0.3)]
)
def test_a_hidden_state_is_followed(name: str, tolerance: float) -> None:
    """At 60 dB the bound is a tenth of a per cent or two; the spline has no kinks where the truth has, at v = 0."""
    lacking = missing_package(name)
    if lacking:
        pytest.skip(lacking)
    problem, truth = record(60)
    estimate = make_method(name, {}).identify(problem, np.random.default_rng(0))
    for group in problem.system.groups:
        marginal = estimate.marginal(group)
        assert marginal is not None
        assert marginal.value == pytest.approx(group.value(truth.parameters), rel=tolerance)


@pytest.mark.parametrize("name", ["ls", "sindy", "ddnn", "era"])
def test_a_regression_says_that_it_cannot(name: str) -> None:
    lacking = missing_package(name)
    if lacking:
        pytest.skip(lacking)
    assert make_method(name, {}).objection(record(20)[0]) is not None


def test_a_start_built_into_the_response_cannot_start_hidden_states() -> None:
    pytest.importorskip("torch")
    sentence = make_method("pinn", {"start": "exact"}).objection(record(20)[0])
    assert sentence is not None
    assert "start=penalty" in sentence
