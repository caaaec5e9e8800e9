"""The response against closed forms, against scipy, and against the conservation of energy."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from more_systems import BoucWen
from scipy import signal
from scipy.integrate import simpson, solve_ivp
from scipy.linalg import expm

from bench import (
    Channel,
    Force,
    InitialState,
    Record,
    acceleration,
    fit_initial_state,
    measurements,
    numpy_ops,
    simulate,
)
from bench.dynamics.simulate import displacements
from bench.scenario.truth import closed_form, reference_response
from bench.systems import SDOF, Chain, Duffing

P = {"m": 1.4, "c": 0.7, "k": 11.0}
CHAIN = {"m1": 1.1, "m2": 0.7, "c1": 0.3, "c2": 0.2, "k1": 13.0, "k2": 8.0}
HARD = {**P, "k3": 6.0}
TIMES = np.linspace(0.0, 9.0, 61)
START = InitialState(np.array([0.8]), np.array([-0.5]))
RESTING = InitialState(np.zeros(1), np.zeros(1))


def free_response(p: dict[str, float], x0: float, v0: float, t: np.ndarray) -> np.ndarray:
    """The three textbook cases, each in its own formula (Inman, Engineering Vibration, section 1.3)."""
    w, zeta = np.sqrt(p["k"] / p["m"]), p["c"] / (2 * np.sqrt(p["k"] * p["m"]))
    if zeta == 1.0:
        return np.exp(-w * t) * (x0 + (v0 + w * x0) * t)
    if zeta < 1.0:
        wd = w * np.sqrt(1 - zeta**2)
        return np.exp(-zeta * w * t) * (x0 * np.cos(wd * t) + (v0 + zeta * w * x0) / wd * np.sin(wd * t))
    r1, r2 = (-zeta + s * np.sqrt(zeta**2 - 1) for s in (1, -1))
    r1, r2 = w * r1, w * r2
    first = (v0 - r2 * x0) / (r1 - r2)
    return first * np.exp(r1 * t) + (x0 - first) * np.exp(r2 * t)


def with_damping(zeta: float) -> dict[str, float]:
    """m = 4 and k = 9, where critical damping c = 12 is exact in floating point."""
    return {"m": 4.0, "c": 12.0 * zeta, "k": 9.0}


@pytest.mark.parametrize("zeta", [1e-4, 0.07, 0.999999, 1.0, 1.000001, 1.5, 80.0])
def test_free_vibration_at_any_damping(zeta: float) -> None:
    p = with_damping(zeta)
    expected = free_response(p, 0.8, -0.5, TIMES)
    np.testing.assert_allclose(closed_form(p, 0.8, -0.5, TIMES), expected, atol=2e-9)
    np.testing.assert_allclose(simulate(SDOF(), p, START, TIMES).displacement[0], expected, atol=2e-9)


def test_many_free_motions_on_long_grids_are_those_of_the_textbook() -> None:
    """Every kind of damping beside one another, on even grids and one that is not; a motion that grows without limit
    is not finite and leaves the others as they are."""
    zetas, rng = [1e-4, 0.07, 1.0, 1.5, -0.01], np.random.default_rng(0)
    starts = [InitialState(np.array([x]), np.array([v])) for x, v in rng.normal(size=(5, 2))]
    grids = [np.linspace(0.0, 9.0, 1000), 9.0 + np.linspace(0.0, 5.0, 301)[1:], 14.0 + np.sort(rng.uniform(0, 9, 250))]
    every = [with_damping(zeta) for zeta in zetas]
    p = {name: np.array([own[name] for own in every]) for name in ("m", "c", "k")}
    for times, paths in zip(grids, displacements(SDOF(), p, starts, grids, [()] * 5), strict=True):
        for own, start, path in zip(every, starts, paths, strict=True):
            expected = free_response(own, float(start.displacement[0]), float(start.velocity[0]), times)
            np.testing.assert_allclose(path[0], expected, atol=2e-9)
    broken = {**p, "c": np.array([*p["c"][:4], -1e4])}
    paths, _, _ = displacements(SDOF(), broken, starts, grids, [()] * 5)
    assert not np.all(np.isfinite(paths[4]))
    np.testing.assert_allclose(paths[:4], displacements(SDOF(), p, starts, grids, [()] * 5)[0][:4], atol=1e-12)


def test_a_chain_against_the_matrix_exponential() -> None:
    m, c, k = np.diag([1.1, 0.7]), np.array([[0.5, -0.2], [-0.2, 0.2]]), np.array([[21.0, -8.0], [-8.0, 8.0]])
    inverse = np.linalg.inv(m)
    a = np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse @ k, -inverse @ c]])
    start = InitialState(np.array([0.5, -0.2]), np.array([0.0, 1.0]))
    state = np.array([0.5, -0.2, 0.0, 1.0])
    expected = np.array([expm(a * t) @ state for t in TIMES]).T
    motion = simulate(Chain(2), CHAIN, start, TIMES)
    np.testing.assert_allclose(motion.displacement, expected[:2], atol=1e-11)
    np.testing.assert_allclose(motion.velocity, expected[2:], atol=1e-11)
    np.testing.assert_allclose(reference_response(Chain(2), CHAIN, start, TIMES), expected[:2], atol=1e-11)


def test_a_chain_of_equal_links_in_phase_and_out_of_phase() -> None:
    """Two equal masses and springs, undamped to rounding: modes at (3 ± √5)/2 k/m with shapes (1, φ) and (φ, -1)."""
    p = {"m1": 1.0, "m2": 1.0, "c1": 1e-12, "c2": 1e-12, "k1": 5.0, "k2": 5.0}
    golden = (1 + np.sqrt(5)) / 2
    for shape, square in (((1.0, golden), (3 - np.sqrt(5)) / 2), ((golden, -1.0), (3 + np.sqrt(5)) / 2)):
        start = InitialState(np.array(shape), np.zeros(2))
        x = simulate(Chain(2), p, start, TIMES).displacement
        np.testing.assert_allclose(x, np.outer(shape, np.cos(np.sqrt(5.0 * square) * TIMES)), atol=1e-9)


def test_the_duffing_oscillator_against_scipy_and_the_truths_own_integrator() -> None:
    def rate(t: float, s: np.ndarray) -> list[float]:
        return [s[1], -(0.7 * s[1] + 11.0 * s[0] + 6.0 * s[0] ** 3) / 1.4]

    solution = solve_ivp(rate, (0, 9), [0.8, -0.5], method="LSODA", t_eval=TIMES, rtol=1e-12, atol=1e-13)
    assert np.max(np.abs(solution.y[0] - free_response(P, 0.8, -0.5, TIMES))) > 0.05  # the cubic term matters here
    np.testing.assert_allclose(reference_response(Duffing(), HARD, START, TIMES)[0], solution.y[0], atol=1e-9)
    motion = simulate(Duffing(), HARD, START, TIMES)
    np.testing.assert_allclose(motion.displacement[0], solution.y[0], atol=1e-5)  # Runge-Kutta, 20 steps a radian
    np.testing.assert_allclose(motion.velocity[0], solution.y[1], atol=3e-5)


def test_a_hidden_state_against_scipy() -> None:
    def rate(t: float, s: np.ndarray) -> list[float]:
        return [s[1], -(0.7 * s[1] + 11.0 * s[2]) / 1.4, s[1] - 0.5 * abs(s[1]) * s[2]]

    solution = solve_ivp(rate, (0, 9), [0.8, -0.5, 0.0], method="LSODA", t_eval=TIMES, rtol=1e-11, atol=1e-12)
    motion = simulate(BoucWen(), P, START, TIMES)
    np.testing.assert_allclose(motion.displacement[0], solution.y[0], atol=1e-4)
    np.testing.assert_allclose(reference_response(BoucWen(), P, START, TIMES)[0], solution.y[0], atol=1e-7)


def test_energy_lost_is_the_work_of_the_dampers() -> None:
    """``E(0) - E(t) = ∫ c v² dt`` for the Duffing oscillator and, link by link, for the chain."""
    t = np.linspace(0.0, 9.0, 4001)
    motion = simulate(Duffing(), HARD, START, t)
    x, v = motion.displacement[0], motion.velocity[0]
    energy = 0.7 * v**2 + 5.5 * x**2 + 1.5 * x**4  # m/2, k/2, k3/4
    assert energy[0] - energy[-1] == pytest.approx(simpson(0.7 * v**2, x=t), rel=1e-5)

    motion = simulate(Chain(2), CHAIN, InitialState(np.array([0.5, -0.2]), np.zeros(2)), t)
    (x1, x2), (v1, v2) = motion.displacement, motion.velocity
    energy = 0.55 * v1**2 + 0.35 * v2**2 + 6.5 * x1**2 + 4.0 * (x2 - x1) ** 2
    lost = simpson(0.3 * v1**2 + 0.2 * (v2 - v1) ** 2, x=t)
    assert energy[0] - energy[-1] == pytest.approx(lost, rel=1e-8)


def step_response(p: dict[str, float], t: np.ndarray) -> np.ndarray:
    """Response to a unit force from t = 0 on: the static deflection minus a free vibration from it."""
    return np.where(t > 0, 1.0 / p["k"] - free_response(p, 1.0 / p["k"], 0.0, np.maximum(t, 0.0)), 0.0)


def ramp_response(p: dict[str, float], t: np.ndarray) -> np.ndarray:
    """Response to the force ``t``: ``t/k - c/k²`` plus the free vibration that starts it from rest."""
    s = np.maximum(t, 0.0)
    steady = s / p["k"] - p["c"] / p["k"] ** 2
    return np.where(t > 0, steady + free_response(p, p["c"] / p["k"] ** 2, -1.0 / p["k"], s), 0.0)


def staircase(force: Force, p: dict[str, float], t: np.ndarray) -> np.ndarray:
    """A held force as a sum of steps; it ends at its last time."""
    jumps = np.diff(np.concatenate([[0.0], force.values[:-1], [0.0]]))
    return sum(jump * step_response(p, t - at) for jump, at in zip(jumps, force.times, strict=True))


def polygon(force: Force, p: dict[str, float], t: np.ndarray) -> np.ndarray:
    """A joined-up force as a sum of ramps, with a jump where it starts and where it ends."""
    slopes = np.diff(force.values) / np.diff(force.times)
    kinks = np.diff(np.concatenate([[0.0], slopes, [0.0]]))
    total = sum(kink * ramp_response(p, t - at) for kink, at in zip(kinks, force.times, strict=True))
    first, last = (force.values[i] * step_response(p, t - force.times[i]) for i in (0, -1))
    return total + first - last


def a_force(hold: str) -> Force:
    """Irregular samples that start late and end early, so that both holds show their ends."""
    times = np.array([0.7, 1.0, 1.9, 2.05, 3.3, 4.4, 5.0, 6.2])
    return Force(times, np.array([1.0, -2.0, 0.5, 3.0, -1.0, -1.5, 2.0, 1.2]), hold)


@pytest.mark.parametrize(("hold", "exact"), [("zero_order", staircase), ("linear", polygon)])
@pytest.mark.parametrize("zeta", [0.07, 1.5])
def test_a_sampled_force_by_superposition_of_steps_and_ramps(hold: str, exact, zeta: float) -> None:
    force, p = a_force(hold), with_damping(zeta)
    expected = exact(force, p, TIMES) + free_response(p, 0.8, -0.5, TIMES)
    np.testing.assert_allclose(simulate(SDOF(), p, START, TIMES, [force]).displacement[0], expected, atol=1e-11)
    np.testing.assert_allclose(reference_response(SDOF(), p, START, TIMES, [force])[0], expected, atol=1e-11)
    almost_linear = {**p, "k3": 1e-13}
    np.testing.assert_allclose(
        reference_response(Duffing(), almost_linear, START, TIMES, [force])[0], expected, atol=1e-8
    )
    np.testing.assert_allclose(
        simulate(Duffing(), almost_linear, START, TIMES, [force]).displacement[0], expected, atol=2e-5
    )


@pytest.mark.parametrize("hold", ["zero_order", "linear"])
def test_a_forced_chain_against_scipys_lsim(hold: str) -> None:
    t = np.linspace(0.0, 9.0, 91)
    values = np.random.default_rng(5).standard_normal(91)
    m, c, k = np.diag([1.1, 0.7]), np.array([[0.5, -0.2], [-0.2, 0.2]]), np.array([[21.0, -8.0], [-8.0, 8.0]])
    inverse = np.linalg.inv(m)
    a = np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse @ k, -inverse @ c]])
    b = np.vstack([np.zeros((2, 1)), inverse[:, [1]]])  # the force acts on the second mass
    system = (a, b, np.eye(2, 4), np.zeros((2, 1)))
    start = np.array([0.5, -0.2, 0.0, 1.0])
    _, expected, _ = signal.lsim(system, values, t, X0=start, interp=hold == "linear")
    force = Force(t, values, hold, dof=1)
    state = InitialState(start[:2], start[2:])
    np.testing.assert_allclose(simulate(Chain(2), CHAIN, state, t, [force]).displacement, expected.T, atol=1e-10)
    np.testing.assert_allclose(reference_response(Chain(2), CHAIN, state, t, [force]), expected.T, atol=1e-10)


def test_the_harmonic_steady_state() -> None:
    """``x = F/√((k - m w²)² + (c w)²) cos(w t - φ)``; straight lines between samples h apart scale a cosine by
    ``(sin(wh/2)/(wh/2))²``."""
    w, h, p = 2.3, 0.02, P
    grid = np.arange(0.0, 60.0 + h / 2, h)
    force = Force(grid, np.cos(w * grid), "linear")
    late = np.linspace(55.0, 60.0, 40)  # the transient has died down by e^-13
    receptance = (np.sin(w * h / 2) / (w * h / 2)) ** 2 / (p["k"] - p["m"] * w**2 + 1j * p["c"] * w)
    expected = np.real(receptance * np.exp(1j * w * late))
    found = simulate(SDOF(), p, RESTING, late, [force]).displacement[0]
    np.testing.assert_allclose(found, expected, atol=3e-6 * abs(receptance) + 2e-6)


def test_a_force_at_critical_damping_where_the_modes_coincide() -> None:
    force = a_force("zero_order")
    found = simulate(SDOF(), with_damping(1.0), START, TIMES, [force]).displacement[0]
    p = with_damping(1.0)
    expected = staircase(force, p, TIMES) + free_response(p, 0.8, -0.5, TIMES)
    np.testing.assert_allclose(found, expected, atol=1e-6)


@pytest.mark.parametrize("forces", [(), (a_force("linear"),)], ids=["free", "forced"])
@pytest.mark.parametrize(("system", "p"), [(SDOF(), P), (Chain(2), CHAIN), (Duffing(), HARD)], ids=["1", "2", "d"])
def test_many_parameter_sets_at_once_are_the_sets_one_by_one(system, p, forces: Sequence[Force]) -> None:
    factors = np.array([0.7, 1.0, 1.3])
    n = system.n_dof
    start = InitialState(np.full(n, 0.3), np.full(n, -0.2))
    sets = {name: value * factors for name, value in p.items() if name not in ("m", "m1")}
    sets |= {name: np.full(3, p[name]) for name in ("m", "m1") if name in p}
    together = simulate(system, sets, start, TIMES, forces).displacement
    assert together.shape == (n, 3, TIMES.size)
    for i in range(3):
        alone = simulate(system, {name: value[i] for name, value in sets.items()}, start, TIMES, forces).displacement
        np.testing.assert_allclose(together[:, i], alone, atol=2e-6 if not system.linear else 1e-11)


def test_a_response_that_diverges_is_not_an_error() -> None:
    motion = simulate(SDOF(), {"m": 1.0, "c": -400.0, "k": 1.0}, START, TIMES)
    assert not np.all(np.isfinite(motion.displacement))
    huge = {"m": 1.0, "c": 1.0, "k": 1e200}  # the square of its entries is infinite
    assert simulate(SDOF(), huge, START, TIMES, [a_force("linear")]).displacement.shape == (1, TIMES.size)
    motion = simulate(Duffing(), {"m": 1.0, "c": 0.1, "k": 1.0, "k3": -50.0}, START, TIMES)
    assert motion.displacement.shape == (1, TIMES.size)


def test_a_motion_that_takes_too_long_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """What was reached before stays; nothing after it is a number."""
    whole = simulate(Duffing(), HARD, START, TIMES).displacement[0]
    monkeypatch.setattr("bench.dynamics.simulate.MAX_RATES", 300)
    part = simulate(Duffing(), HARD, START, TIMES).displacement[0]
    reached = int(np.argmin(np.isfinite(part)))
    assert 0 < reached < TIMES.size
    assert not np.any(np.isfinite(part[reached:]))
    np.testing.assert_allclose(part[:reached], whole[:reached], rtol=1e-6)


def test_what_ideal_sensors_give() -> None:
    """Displacement, velocity and acceleration of the second mass; the acceleration from Newton's law with the force."""
    force = Force([0.0, 9.0], [0.5, 2.0], dof=1)
    start = InitialState(np.array([0.5, -0.2]), np.array([0.0, 1.0]))
    zeros = np.zeros(TIMES.size)
    channels = (
        Channel(TIMES, zeros, dof=1),
        Channel(TIMES, zeros, "velocity", 1),
        Channel(TIMES, zeros, "acceleration", 1),
    )
    x, v, a = measurements(Chain(2), CHAIN, start, Record(channels, (force,), start)).reshape(3, -1)
    motion = simulate(Chain(2), CHAIN, start, TIMES, [force])
    np.testing.assert_array_equal(x, motion.displacement[1])
    np.testing.assert_array_equal(v, motion.velocity[1])
    pull = 0.2 * (v - motion.velocity[0]) + 8.0 * (x - motion.displacement[0])
    np.testing.assert_allclose(a, (0.5 + 1.5 * TIMES / 9.0 - pull) / 0.7, atol=1e-12)
    own = acceleration(Chain(2), CHAIN, motion.displacement, motion.velocity, [0 * x, force(TIMES)], [], numpy_ops)
    np.testing.assert_allclose(a, own[1], atol=1e-12)


def test_the_start_that_fits_a_record_is_the_true_one_on_clean_data() -> None:
    t = np.linspace(0.0, 8.0, 20)
    clean = free_response(P, 0.8, -0.5, t)
    record = Record((Channel(t, clean + 0.3, offset=True),))
    start = fit_initial_state(SDOF(), P, record)
    assert start.displacement[0] == pytest.approx(0.8, abs=1e-9)
    assert start.velocity[0] == pytest.approx(-0.5, abs=1e-8)
    told = fit_initial_state(SDOF(), P, Record((Channel(t, clean),), initial_state=RESTING))
    assert told is RESTING


def test_the_start_that_fits_a_nonlinear_record() -> None:
    t = np.linspace(0.0, 8.0, 40)
    clean = reference_response(Duffing(), {**P, "k3": 3.0}, START, t)[0]
    start = fit_initial_state(Duffing(), {**P, "k3": 3.0}, Record((Channel(t, clean),)))
    assert start.displacement[0] == pytest.approx(0.8, abs=1e-4)
    assert start.velocity[0] == pytest.approx(-0.5, abs=1e-3)


def test_a_start_cannot_be_fitted_to_what_is_not_a_motion_of_the_system_and_stays_finite() -> None:
    record = Record((Channel(np.linspace(0, 8, 12), np.zeros(12)),))
    start = fit_initial_state(SDOF(), P, record)
    np.testing.assert_array_equal(start.displacement, 0.0)
    np.testing.assert_array_equal(start.velocity, 0.0)
