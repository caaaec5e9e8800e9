"""Bouc-Wen, whose hysteretic displacement no sensor shows: methods that carry hidden states, and others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bench import Channel, InitialState, Prior, Problem, Record, Status
from bench.config.experiment import expand
from bench.entrants.registry import make_method, missing_package
from bench.scenario.truth import Truth
from bench.systems import SDOF, System


def record(snr: int) -> tuple[Problem, Truth]:
    """The configured Bouc-Wen oscillator; its truth comes from another integrator than the methods use."""
    override = ["method=prior", "system=bouc_wen", f"snr={snr}"]
    return expand(override, multirun=False)[0].cell().scenario.replicates(17, 1)[0]


@pytest.mark.parametrize(
    ("name", "tolerance"),
    [
        ("shooting", 0.01),
        pytest.param("output_error", 0.01, marks=pytest.mark.slow),
        ("ekf", 0.01),
        ("collocation", 0.3),
    ],
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
        assert marginal.value == pytest.approx(group.value(truth.parameters), rel=tolerance)
        if name == "collocation":
            assert "too narrow" in estimate.message  # and they are
        else:
            low, high = marginal.interval(0.99999)
            assert low < group.value(truth.parameters) < high


@dataclass(frozen=True)
class Follower(System):
    """A spring beside one that follows it, unstretched at first: ``z' = x' / 2``, a hidden rate without parameters."""

    name = "follower"
    linear = False
    n_hidden = 1
    parameters = SDOF().parameters
    groups = SDOF().groups

    def residual(self, p, x, v, a, f, z, ops):
        return [p["m"] * a[0] + p["c"] * v[0] + p["k"] * (x[0] + z[0]) - f[0]]

    def hidden_rates(self, p, x, v, f, z, ops):
        return [0.5 * v[0]]


@pytest.mark.parametrize("name", ["shooting", pytest.param("output_error", marks=pytest.mark.slow), "collocation"])
def test_a_broken_exponent_has_slopes_at_rest(name: str) -> None:
    """z starts at zero, where ``|z|^1.5`` and ``z |z|^0.5`` have no slope by the rules of their parts."""
    lacking = missing_package(name)
    if lacking:
        pytest.skip(lacking)
    override = ["method=prior", "system=bouc_wen", "system.options.exponent=1.5", "snr=40"]
    problem, _ = expand(override, multirun=False)[0].cell().scenario.replicates(17, 1)[0]
    assert make_method(name, {}).identify(problem, np.random.default_rng(0)).status is Status.OK


@pytest.mark.parametrize(
    ("name", "settings"),
    [("shooting", {}), ("collocation", {}), pytest.param("pinn", {"iterations": 400}, marks=pytest.mark.slow)],
)
def test_a_hidden_rate_needs_no_parameter(name: str, settings: dict[str, object]) -> None:
    """Against SciPy's LSODA; the mass is the prior's, so k/m and c/m are judged. By default the PINN ends too early."""
    lacking = missing_package(name)
    if lacking:
        pytest.skip(lacking)
    m, c, k = 1.0, 0.3, 8.0
    times = np.linspace(0.0, 8.0, 60)

    def rate(t: float, s: np.ndarray) -> list[float]:
        return [s[1], -(c * s[1] + k * (s[0] + s[2])) / m, 0.5 * s[1]]

    path = solve_ivp(rate, (0.0, 8.0), [1.0, 0.0, 0.0], "LSODA", times, rtol=1e-10, atol=1e-12).y[0]
    noisy = path + 0.003 * np.random.default_rng(0).standard_normal(times.size)
    start = InitialState(np.array([1.0]), np.array([0.0]))
    prior = Prior({"m": 1.0, "c": 0.5, "k": 6.0}, {"m": 0.02, "c": 1.0, "k": 0.5})
    problem = Problem(Follower(), (Record((Channel(times, noisy),), (), start),), prior)
    estimate = make_method(name, settings).identify(problem, np.random.default_rng(0))
    for group in Follower().groups:
        marginal = estimate.marginal(group)
        assert marginal.value == pytest.approx(group.value({"m": m, "c": c, "k": k}), rel=0.03)


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


@pytest.mark.parametrize(("system", "broken"), [("coulomb", True), ("duffing", False)])
def test_a_spline_that_violates_the_equation_of_motion_warns(system: str, broken: bool) -> None:
    """Dry friction has kinks that no spline follows; a cubic spring has none."""
    override = ["method=prior", f"system={system}", "snr=40"]
    problem, _ = expand(override, multirun=False)[0].cell().scenario.replicates(17, 1)[0]
    estimate = make_method("collocation", {}).identify(problem, np.random.default_rng(0))
    assert ("violates the equation of motion" in estimate.message) == broken
