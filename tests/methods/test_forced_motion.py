"""What forces alone would do, and the fits that rest on it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.signal import lsim

from bench import Channel, Force, InitialState, Problem, Record, measurements
from bench.config.experiment import expand
from bench.entrants.registry import make_method, missing_package
from bench.systems import SDOF
from methods.starts.forced_motion import ForcedMotion, forced_motion
from methods.starts.waves import scan

RATE = -0.3 + 2.0j
STEP = Force(np.array([0.0, 0.7, 9.0]), np.array([0.0, 2.0, 2.0]), "zero_order")


def test_a_step_gives_duhamels_integral() -> None:
    """``2 (1 - exp(-d t) (cos w t + d/w sin w t)) / (w² + d²)`` at t after the step."""
    times = np.array([0.0, 0.3, 0.7, 1.1, 4.0, 8.0])
    d, w, t = 0.3, 2.0, np.maximum(times - 0.7, 0.0)
    expected = 2.0 * (1.0 - np.exp(-d * t) * (np.cos(w * t) + d / w * np.sin(w * t))) / (w**2 + d**2)
    computed = forced_motion([STEP], np.array(RATE), times)
    assert computed.shape == (3, times.size, 1)
    assert np.allclose(computed[0, :, 0], expected, atol=1e-12)


def test_a_joined_force_gives_the_response_of_another_library() -> None:
    """scipy's ``lsim`` is exact for a force that is linear between its samples."""
    times = np.linspace(0.0, 6.0, 41)
    force = np.random.default_rng(0).standard_normal(41)
    poles = ([1.0], [1.0, 0.6, 0.3**2 + 2.0**2])
    expected = lsim(poles, force, times)[1]
    assert np.allclose(forced_motion([Force(times, force)], np.array(RATE), times)[0, :, 0], expected, atol=1e-10)


def test_the_streams_obey_the_oscillators_equation() -> None:
    """``q'' + 2 d q' + (w² + d²) q = f``, force by force of each degree of freedom, at times in any order."""
    times = np.random.default_rng(1).uniform(0.0, 8.0, 50)
    wave = Force(np.linspace(0.0, 9.0, 30), np.cos(np.linspace(0.0, 9.0, 30) ** 2), "cubic", dof=2)
    forces = [STEP, wave, dataclasses.replace(wave, values=0.5 * wave.values)]
    x, v, a = forced_motion(forces, np.array(RATE), times)
    assert np.allclose(a + 0.6 * v + (0.3**2 + 2.0**2) * x, np.stack([STEP(times), 1.5 * wave(times)], 1))
    h = 1e-4
    ahead, behind = (forced_motion(forces, np.array(RATE), times + side)[0] for side in (h, -h))
    assert np.allclose((ahead - behind) / (2 * h), v, atol=1e-6)


def test_many_oscillators_are_each_alone() -> None:
    rates, times = np.array([[RATE, -1 + 5j], [-0.1 + 1j, -3 + 3j]]), np.linspace(0.0, 8.0, 20)
    together = forced_motion([STEP], rates, times)
    assert together.shape == (2, 2, 3, 20, 1)
    assert np.allclose(together[1, 1], forced_motion([STEP], rates[1, 1], times))


def test_functions_are_of_unit_size() -> None:
    times = np.linspace(0.0, 8.0, 200)
    assert np.mean(ForcedMotion.of([STEP], RATE, times)(times) ** 2) == pytest.approx(1.0)


@pytest.mark.parametrize("towards", [1.0, 1j])
def test_another_oscillator_is_followed_to_first_order(towards: complex) -> None:
    """At a rate 2 % away, the motion with its derivatives misses 0.2 % of the motion; alone it misses 6 %."""
    times = np.linspace(0.0, 8.0, 200)
    functions = ForcedMotion.of([STEP], RATE, times)(times).T
    other = forced_motion([STEP], np.array(RATE + 0.02 * abs(RATE) * towards), times)[0, :, 0]
    alone, all_three = (
        np.std(other - columns @ np.linalg.lstsq(columns, other, rcond=None)[0]) / np.std(other)
        for columns in (functions[:, :1], functions)
    )
    assert all_three < 0.05 * alone


def _problem(system: str, snr: int) -> tuple[Problem, dict[str, float]]:
    (problem, truth), *_ = (
        expand(["method=prior", f"system={system}", f"snr={snr}"], multirun=False)[0].cell().scenario.replicates(31, 1)
    )
    return problem, dict(truth.parameters)


def test_the_scan_sees_the_vibration_under_a_step() -> None:
    """The plateau is most of the data: without the force a slow wave fits it best, far below the true frequency."""
    problem, p = _problem("sdof_step", 20)
    units = problem.natural_units()
    true = np.sqrt(p["k"] / p["m"]) * units.time
    scaled = problem.expressed_in(units)
    assert scan(scaled, forced=True)[0][0].omega == pytest.approx(true, rel=0.1)
    assert scan(scaled)[0][0].omega < 0.6 * true


@pytest.mark.parametrize("method", ["pinn", "collocation"])
@pytest.mark.parametrize("system", ["sdof_step", "sdof_impulse"])
def test_a_force_that_jumps_is_followed(system: str, method: str) -> None:
    """Their bounds at 40 dB are below 1 %; a smooth response alone was wrong by a hundred times that."""
    problem, p = _problem(system, 40)
    estimate = make_method(method, {}).identify(problem, np.random.default_rng(0))
    for name, value in zip(estimate.parameters.names, np.exp(estimate.parameters.mean), strict=True):
        assert value == pytest.approx(p[name], rel=0.04)


@pytest.mark.parametrize("method", ["pinn", "collocation"])
def test_after_a_blow_the_answer_is_that_of_least_squares(method: str) -> None:
    """Deviations of log-parameters and their mean agree with those of a simulation fitted by least squares."""
    problem, _ = _problem("sdof_impulse", 40)
    fitted, simulated = (
        make_method(name, {}).identify(problem, np.random.default_rng(0)).parameters
        for name in (method, "output_error")
    )
    widths = np.sqrt(np.diag(simulated.covariance))
    assert np.all(np.abs(fitted.mean - simulated.mean) < 0.5 * widths)
    assert np.sqrt(np.diag(fitted.covariance)) == pytest.approx(widths, rel=0.5)


@pytest.mark.parametrize("samples", [100, 300])
def test_a_step_is_followed_in_short_and_long_records(samples: int) -> None:
    """Above a hundred samples the scan takes the force itself for the oscillators' responses; bound below 2 %."""
    override = ["method=prior", "system=sdof_step", "snr=20", f"system.samples={samples}"]
    (problem, truth), *_ = expand(override, multirun=False)[0].cell().scenario.replicates(31, 1)
    estimate = make_method("collocation", {}).identify(problem, np.random.default_rng(0))
    assert np.exp(estimate.parameters.mean[0]) == pytest.approx(truth.parameters["m"], rel=0.08)


@pytest.mark.parametrize("method", ["pinn", "collocation"])
def test_a_damping_that_the_noise_hides_is_held(method: str) -> None:
    """Two masses at 10 dB: in this record the likelihood of c2 rises towards zero. The very wide prior has a log
    standard deviation of 3, so no interval is wider than its own, and none may be falsely narrow.
    """
    override = ["method=prior", "system=chain2_forced", "snr=10"]
    problem, truth = expand(override, multirun=False)[0].cell().scenario.replicates(0, 2)[1]
    estimate = make_method(method, {}).identify(problem, np.random.default_rng(0))
    assert "very wide prior" in estimate.message
    computed = estimate.parameters
    widths = np.sqrt(np.diag(computed.covariance))
    away = (computed.mean - np.log([truth.parameters[name] for name in computed.names])) / widths
    assert 1.0 < np.max(widths) <= 3.0
    assert np.all(np.abs(away) < 4.0)


def _sensed(measures: str) -> tuple[Problem, dict[str, float]]:
    """The forced oscillator at 40 dB of its own sensors' signal: here velocities, or accelerations, from time 0 on."""
    problem, p = _problem("sdof_forced", 40)
    record = problem.records[0]
    assert record.initial_state is not None
    ideal = Channel(record.channels[0].times, record.channels[0].values, measures)
    clean = measurements(problem.system, p, record.initial_state, dataclasses.replace(record, channels=(ideal,)))
    noise = 0.01 * np.std(clean) * np.random.default_rng(5).standard_normal(clean.size)
    sensed = dataclasses.replace(record, channels=(dataclasses.replace(ideal, values=clean + noise),))
    return dataclasses.replace(problem, records=(sensed,)), p


@pytest.mark.parametrize("measures", ["velocity", "acceleration"])
@pytest.mark.parametrize(
    "settings", [{}, pytest.param({"uncertainty": "bootstrap", "members": 8}, marks=pytest.mark.slow)]
)
def test_sensors_of_velocity_and_acceleration_serve_under_a_force(measures: str, settings: dict[str, object]) -> None:
    """1 % noise on 25 samples: each parameter to a few per cent, and the intervals of that size, not of the edge's."""
    problem, p = _sensed(measures)
    estimate = make_method("collocation", settings).identify(problem, np.random.default_rng(0))
    computed = estimate.parameters
    away = computed.mean - np.log([p[name] for name in computed.names])
    widths = np.sqrt(np.diag(computed.covariance))
    assert np.all(np.abs(away) < 0.05)
    assert np.all((widths > 1e-4) & (widths < 0.03))


@pytest.mark.parametrize("method", ["shooting", "collocation", "ekf"])
def test_two_masses_under_a_force_are_told_with_widths_to_match(method: str) -> None:
    """At 40 dB the six parameters are told to a few per cent at worst; errors beyond 4.5 widths come once in 10^5."""
    lacking = missing_package(method)
    if lacking:
        pytest.skip(lacking)
    problem, p = _problem("chain2_forced", 40)
    estimate = make_method(method, {}).identify(problem, np.random.default_rng(0)).parameters
    away = estimate.mean - np.log([p[name] for name in estimate.names])
    widths = np.sqrt(np.diag(estimate.covariance))
    assert np.all(np.abs(away) < 4.5 * widths)
    assert np.all(widths < 0.1)


@pytest.mark.parametrize("name", ["ekf", "ukf", "output_error", "shooting", "mcmc"])
def test_several_records_sensors_and_a_force(name: str) -> None:
    """A forced record from a known start and a free one with an accelerometer and its offset, without a prior."""
    lacking = missing_package(name)
    if lacking:
        pytest.skip(lacking)
    system, rng, p = SDOF(), np.random.default_rng(0), {"m": 1.3, "c": 0.6, "k": 9.0}
    times, knots = np.linspace(0, 8, 30), np.linspace(0, 8, 60)
    push = Force(knots, 3.0 * np.sin(2 * np.pi * 0.35 * knots) + 2.0 * np.cos(5.0 * knots))
    start, records = InitialState(np.array([0.5]), np.array([0.0])), []
    for measures, forces, known in (("displacement", (push,), True), ("acceleration", (), False)):
        blank = Channel(times, times, measures, offset=not known)
        clean = measurements(system, p, start, Record((blank,), forces))
        noisy = clean + 0.03 * np.sqrt(np.mean(clean**2)) * rng.standard_normal(clean.size) + 0.4 * (not known)
        records.append(Record((dataclasses.replace(blank, values=noisy),), forces, start if known else None))
    settings = {"effective": 200.0} if name == "mcmc" else {}
    estimate = make_method(name, settings).identify(Problem(system, tuple(records)), np.random.default_rng(0))
    for parameter, true in p.items():
        marginal = estimate.marginal(system.quantity(parameter))
        assert marginal is not None, estimate.message
        low, high = marginal.interval(0.999)
        assert low < true < high
    assert estimate.offsets[1] == pytest.approx(0.4, abs=0.1)
