"""The Cramér-Rao bound: the protocol's numbers, closed forms, and the groups that the data can tell."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.information import fisher
from bench.information.fisher import Bound, compute_bound, sensitivities
from bench.scenario.disturbance import Irregular
from bench.scenario.scenario import ForceSpec, PriorSpec, Scenario
from bench.scenario.truth import reference_response
from bench.systems import System

SDOF_TRUE = {"m": 1.0, "c": 0.4, "k": 8.0}
SDOF_FREE = Scenario("sdof", SDOF_TRUE, ((1.0,), (0.0,)), 20.0)
CHAIN_TRUE = {"m1": 1.0, "m2": 0.8, "c1": 0.2, "c2": 0.15, "k1": 12.0, "k2": 9.0}
CHAIN_FREE = Scenario("chain", CHAIN_TRUE, ((1.0, 0.0), (0.0, 0.0)), 20.0, 4.0, samples=40, options={"n": 2})
DUFFING_FREE = Scenario("duffing", {**SDOF_TRUE, "k3": 5.0}, ((1.0,), (0.0,)), 20.0, 4.0, samples=40)
MULTISINE = ForceSpec(1.0, 0.1, 1.0, tones=5, samples=41)
NOMINAL = PriorSpec("nominal", {"mass": 0.02, "damping": 1.0, "stiffness": 0.5, "other": 0.5})


@pytest.fixture(scope="module", autouse=True)
def _share_sensitivities() -> Any:
    """Sensitivities depend on neither noise nor what is told: compute them once for scenarios that differ in those."""
    known: dict[str, tuple[np.ndarray, np.ndarray]] = {}

    def shared(scenario: Scenario, seed: int, times: np.ndarray, record: int = 0) -> tuple[np.ndarray, np.ndarray]:
        if record or not np.isin(scenario.times, times).all():
            return sensitivities(scenario, seed, times, record)
        same_data = {**scenario.data_identity(), "force": scenario.forces(seed)[0].values[:3] if scenario.force else 0}
        key = repr(({k: v for k, v in same_data.items() if k != "snr_db"}, times.size, float(np.sum(times))))
        if key not in known:
            known[key] = sensitivities(scenario, seed, times)
        return known[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fisher, "sensitivities", shared)
        yield


def on_its_samples(scenario: Scenario, **changes: Any) -> Scenario:
    """The scenario scored on its own sample times, with next to no forecast: the displacement bound is then N and p."""
    return replace(scenario, dense=changes.get("samples", scenario.samples), forecast=0.5, **changes)


def closed_form(logs: np.ndarray, x0: complex, v0: complex, t: np.ndarray) -> np.ndarray:
    """``e^(-at) (x0 cos wd t + (v0 + a x0)/wd sin wd t)``, analytic in everything: complex steps differentiate it."""
    m, c, k = np.exp(logs)
    a = c / (2 * m)
    wd = np.sqrt(k / m - a * a)
    return np.asarray(np.exp(-a * t) * (x0 * np.cos(wd * t) + (v0 + a * x0) / wd * np.sin(wd * t)))


def gradient_of_closed_form(t: np.ndarray) -> np.ndarray:
    """Derivatives by log m, log c, log k, x0, v0 at the reference system, shape (n, 5), exact to rounding."""
    theta = np.array([math.log(1.0), math.log(0.4), math.log(8.0), 1.0, 0.0])
    columns = []
    for i in range(5):
        step = theta + 1e-30j * (np.arange(5) == i)
        columns.append(np.imag(closed_form(step[:3], step[3], step[4], t)) / 1e-30)
    return np.stack(columns, axis=1)


PROTOCOL = {
    "known": {40: 0.0011, 30: 0.0034, 20: 0.0107, 10: 0.0339, 5: 0.0604},
    "unknown": {40: 0.0015, 30: 0.0046, 20: 0.0147, 10: 0.0464, 5: 0.0825},
}
"""Displacement RMSE bounds (m) by SNR (dB) that the benchmark's protocol states, computed apart from this code."""


@pytest.mark.parametrize("told", ["known", "unknown"])
@pytest.mark.parametrize("snr", [40, 30, 20, 10, 5])
def test_the_protocols_displacement_bounds(told: str, snr: int) -> None:
    found = compute_bound(replace(SDOF_FREE, snr_db=float(snr), initial_state=told)).rmse
    assert found == pytest.approx(PROTOCOL[told][snr], abs=0.00005000001)


def test_the_sensitivities_are_those_of_the_closed_form() -> None:
    scenario = on_its_samples(SDOF_FREE)
    times = np.unique(np.concatenate([scenario.times, scenario.forecast_times]))
    response, gradient = fisher.sensitivities(scenario, 0, times)
    exact = gradient_of_closed_form(times)
    np.testing.assert_allclose(response[0], np.real(closed_form(np.log([1.0, 0.4, 8.0]), 1.0, 0.0, times)), atol=1e-8)
    np.testing.assert_allclose(gradient[0], exact, atol=1e-7)


def test_fisher_information_and_bound_are_those_of_the_closed_form() -> None:
    """Bound of k/m and c/m from J'J/σ² of the closed form by the two groups, at the noise that the SNR defines."""
    t = np.linspace(0, 10, 25)
    clean = np.real(closed_form(np.log([1.0, 0.4, 8.0]), 1.0, 0.0, t))
    sigma = np.sqrt(np.mean(clean**2) / 100.0)
    dense = gradient_of_closed_form(np.linspace(0, 10, 1000))
    for told, free in (("known", [1, 2]), ("unknown", [1, 2, 3, 4])):
        g = gradient_of_closed_form(t)[:, free]  # with m fixed, log c and log k are log c/m and log k/m
        covariance = np.linalg.inv(g.T @ g) * sigma**2
        found = compute_bound(replace(SDOF_FREE, initial_state=told))
        assert found.relative_sd["c_over_m"] == pytest.approx(np.sqrt(covariance[0, 0]), rel=1e-6)
        assert found.relative_sd["k_over_m"] == pytest.approx(np.sqrt(covariance[1, 1]), rel=1e-6)
        w = np.array([1.0, -0.5, 0.0, 0.0][: len(free)])  # log of damping ratio = log c - ½ log k + ...
        assert found.relative_sd["damping_ratio"] == pytest.approx(np.sqrt(w @ covariance @ w), rel=1e-6)
        variance = np.einsum("ti,ij,tj->t", dense[:, free], covariance, dense[:, free])
        assert found.rmse == pytest.approx(np.sqrt(np.mean(variance)), rel=1e-6)


@pytest.mark.parametrize(
    ("scenario", "told", "unknowns"),
    [
        (SDOF_FREE, "known", 2),
        (SDOF_FREE, "unknown", 4),
        (DUFFING_FREE, "known", 3),
        (DUFFING_FREE, "unknown", 5),
        (replace(SDOF_FREE, force=MULTISINE), "known", 3),
        (replace(SDOF_FREE, force=MULTISINE), "unknown", 5),
    ],
    ids=["sdof", "sdof-start", "duffing", "duffing-start", "forced", "forced-start"],
)
def test_on_the_samples_the_mean_variance_is_sigma_squared_times_p_over_n(
    scenario: Scenario, told: str, unknowns: int
) -> None:
    """The trace of a projection on p columns is p: over the samples themselves, the bound is ``σ √(p/N)`` exactly."""
    scenario = on_its_samples(scenario, initial_state=told)
    sigma = scenario.sigmas(0)[0]
    assert compute_bound(scenario).rmse == pytest.approx(sigma * np.sqrt(unknowns / scenario.samples), rel=1e-6)


def test_with_parameters_known_only_the_start_is_a_linear_gaussian_problem() -> None:
    """Parameters held to one part in 10¹²: x is linear in x0 and v0, whose regression leaves ``σ √(2/N)``."""
    exact = PriorSpec("exact", dict.fromkeys(("mass", "damping", "stiffness", "other"), 1e-12))
    scenario = on_its_samples(SDOF_FREE, initial_state="unknown", prior=exact)
    assert compute_bound(scenario).rmse == pytest.approx(scenario.sigmas(0)[0] * np.sqrt(2 / 25), rel=1e-6)


def declared(scenario: Scenario) -> tuple[System, Bound]:
    return scenario.make_system(), compute_bound(scenario)


@pytest.mark.parametrize("told", ["known", "unknown"])
@pytest.mark.parametrize("scenario", [SDOF_FREE, CHAIN_FREE, DUFFING_FREE], ids=["sdof", "chain", "duffing"])
def test_free_vibration_tells_exactly_the_groups_that_the_system_declares(scenario: Scenario, told: str) -> None:
    """Scaling all masses, dampings and stiffnesses alike changes nothing: one null direction, that of equal logs."""
    system, bound = declared(on_its_samples(scenario, initial_state=told))
    null = np.array(bound.null_space)
    assert null.shape == (1, len(system.names))
    np.testing.assert_allclose(np.abs(null[0]), 1 / np.sqrt(len(system.names)), atol=1e-6)
    groups = np.array([group.vector(system.names) for group in system.groups])
    assert np.linalg.matrix_rank(groups) == len(system.names) - len(null)
    for quantity in (*system.groups, *system.modal):
        assert bound.identifiable[quantity.name], quantity.name
        assert math.isfinite(bound.relative_sd[quantity.name])
    for name in system.names:
        assert not bound.identifiable[name]
        assert bound.relative_sd[name] == math.inf


@pytest.mark.parametrize("told", ["known", "unknown"])
@pytest.mark.parametrize("scenario", [SDOF_FREE, CHAIN_FREE, DUFFING_FREE], ids=["sdof", "chain", "duffing"])
def test_a_known_force_tells_everything(scenario: Scenario, told: str) -> None:
    system, bound = declared(on_its_samples(scenario, initial_state=told, force=MULTISINE))
    assert bound.null_space == ()
    assert all(bound.identifiable.values())
    assert all(math.isfinite(bound.relative_sd[name]) for name in system.names)


def test_three_samples_do_not_tell_two_groups_and_a_start() -> None:
    """Three equations: with the start known, two groups; with it unknown, four unknowns, so one combination is lost."""
    three = on_its_samples(SDOF_FREE, samples=3, duration=2.0)
    known, unknown = (compute_bound(replace(three, initial_state=told)) for told in ("known", "unknown"))
    assert (len(known.null_space), len(unknown.null_space)) == (1, 2)
    assert known.identifiable["k_over_m"]
    assert not unknown.identifiable["k_over_m"]
    assert unknown.relative_sd["k_over_m"] == math.inf


def test_forced_sensitivities_are_finite_differences_of_the_truths_own_response() -> None:
    """The truth is made by scipy's matrix exponential, of matrices that are not those of the sensitivities."""
    scenario = on_its_samples(replace(SDOF_FREE, force=MULTISINE))
    times = np.unique(np.concatenate([scenario.times, scenario.forecast_times]))
    _, gradient = fisher.sensitivities(scenario, 0, times)
    system, forces = scenario.make_system(), scenario.forces(0)
    for i, name in enumerate(system.names):
        sides = []
        for sign in (1, -1):
            p = {**SDOF_TRUE, name: SDOF_TRUE[name] * math.exp(sign * 1e-5)}
            sides.append(reference_response(system, p, scenario.start, times, forces)[0])
        np.testing.assert_allclose(gradient[0, :, i], (sides[0] - sides[1]) / 2e-5, atol=1e-7)


def test_with_a_prior_the_mass_is_the_priors_and_k_over_m_the_datas() -> None:
    """The weighing stays at 2 %: information on k from its own prior of 50 % adds 0.04² to it in relative variance."""
    bound = compute_bound(replace(SDOF_FREE, prior=NOMINAL))
    assert bound.prior_share["m"] > 0.999
    assert bound.relative_sd["m"] == pytest.approx(0.02, rel=2e-3)
    assert bound.prior_share["k_over_m"] < 0.01
    assert bound.prior_share["c_over_m"] < 0.01
    assert not bound.identifiable["m"]
    free = compute_bound(SDOF_FREE)
    assert bound.relative_sd["k_over_m"] == pytest.approx(free.relative_sd["k_over_m"], rel=1e-3)
    expected = np.hypot(bound.relative_sd["m"], bound.relative_sd["k_over_m"])  # k = m (k/m), nearly independent
    assert bound.relative_sd["k"] == pytest.approx(expected, rel=1e-3)


def test_without_signal_the_bound_is_the_prior() -> None:
    bound = compute_bound(replace(SDOF_FREE, snr_db=-140.0, prior=NOMINAL))
    for name, sd in (("m", 0.02), ("c", 1.0), ("k", 0.5), ("k_over_m", math.hypot(0.5, 0.02))):
        assert bound.relative_sd[name] == pytest.approx(sd, rel=1e-6)
        assert bound.prior_share[name] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("snr", [0.0, 40.0, 120.0])
@pytest.mark.parametrize("told", ["known", "unknown"])
def test_the_mass_of_a_long_free_record_is_the_priors_however_much_the_data_tell_of_the_rest(
    snr: float, told: str
) -> None:
    """2,250 cycles tell k/m so much better than the prior tells m that its part is below their rounding."""
    long = {"duration": 2250.0, "samples": 9000, "dense": 25, "forecast": 1.0, "initial_state": told}
    p = {"m": 2.0, "c": 0.004, "k": 2.0 * (2 * math.pi) ** 2}
    bound = compute_bound(replace(SDOF_FREE, parameters=p, snr_db=snr, prior=NOMINAL, **long))
    weighings = 1 / 0.02**2 + 1 / 1.0**2 + 1 / 0.5**2  # with k/m and c/m known, each prior is one of the mass
    tells = 1e-6 if snr else 1e-2  # at 0 dB c/m is known to some percent
    assert bound.relative_sd["m"] == pytest.approx(weighings**-0.5, rel=tells)
    assert bound.relative_sd["k"] == pytest.approx(weighings**-0.5, rel=tells)
    assert bound.prior_share["m"] == pytest.approx(1.0, abs=tells)
    alone = compute_bound(replace(SDOF_FREE, parameters=p, snr_db=snr, **long))
    assert bound.relative_sd["k_over_m"] == pytest.approx(alone.relative_sd["k_over_m"], rel=1e-3)


COMPILE = """import sys
from pathlib import Path
import numpy as np
from bench.contract.problem import InitialState
from bench.information.sensitivities import stepped_sensitivities
from bench.systems.linear import SDOF
start = InitialState(np.array([1.0]), np.array([0.0]))
x, slopes = stepped_sensitivities(SDOF(), {"m": 1.0, "c": 0.4, "k": 8.0}, start, np.array([0.0, 0.5]))
print(repr(x.tolist()), repr(slopes.tolist()))
"""


@pytest.mark.slow
def test_what_jax_compiles_is_kept_for_the_next_process_where_it_can_be(
    tmp_path: Path, python: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)  # the user's own choice would win
    (tmp_path / "file").touch()
    found = [
        python("-W", "error", "-c", COMPILE, env={"XDG_CACHE_HOME": str(tmp_path / name)})
        for name in ("cache", "cache", "file")
    ]
    assert [asked.stderr for asked in found] == ["", "", ""]
    assert len({asked.stdout for asked in found}) == 1
    assert list((tmp_path / "cache" / "vibration-bench" / "jax").glob("jit_response-*"))


@pytest.mark.parametrize("replicates", [1, 4])
def test_times_that_each_replicate_has_of_its_own_are_those_of_its_bound(replicates: int) -> None:
    """The samples as methods are given them, the closed form's derivatives at their times, and normal equations."""
    scenario = replace(SDOF_FREE, prior=NOMINAL, initial_state="unknown", disturbance=Irregular(1.0))
    widths = np.array([NOMINAL.sd_by_kind[kind] for kind in ("mass", "damping", "stiffness")] + [np.inf] * 2)
    variances = []
    for problem, _ in scenario.replicates(3, replicates):
        times = problem.records[0].channels[0].times
        assert np.ptp(np.diff(times)) > 0.1, "not the uniform grid"
        gradient = gradient_of_closed_form(times) / scenario.sigmas(3)[0]
        inverse = np.linalg.inv(gradient.T @ gradient + np.diag(widths**-2.0))
        variances.append([inverse[0, 0], inverse[1, 1], inverse[2, 2]])
    found = compute_bound(scenario, 3, replicates).relative_sd
    np.testing.assert_allclose([found[name] for name in "mck"], np.sqrt(np.mean(variances, axis=0)), rtol=1e-6)


def test_two_records_at_times_of_their_own_tell_what_both_tell() -> None:
    """With an added mass each record has its own times; the data streams say which."""
    scenario = replace(SDOF_FREE, added_mass=(0.5,), disturbance=Irregular(1.0))
    ((problem, _),) = scenario.replicates(5, 1)
    total = np.zeros((3, 3))
    for number, (record, added) in enumerate(zip(problem.records, (0.0, 0.5), strict=True)):
        times, step, rows = record.channels[0].times, 1e-20j, []
        for i, name in enumerate("mck"):
            logs = np.log([SDOF_TRUE[name] for name in "mck"]).astype(complex)
            logs[i] += step
            p = np.exp(logs)
            rows.append(closed_form(np.log([p[0] + added, p[1], p[2]]), 1.0, 0.0, times).imag / step.imag)
        scaled = np.array(rows) / scenario.sigmas(5, number)[0]
        total += scaled @ scaled.T
    found = compute_bound(scenario, 5).relative_sd
    np.testing.assert_allclose([found[name] for name in "mck"], np.sqrt(np.diag(np.linalg.inv(total))), rtol=1e-6)
