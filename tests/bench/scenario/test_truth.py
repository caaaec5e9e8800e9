"""The truth and the simulation of nonlinear systems against closed forms, asymptotics and the balance of energy."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import ellipj, ellipk

from bench import Channel, Force, InitialState, Record, fit_initial_state, measurements, simulate
from bench.scenario.truth import closed_form, reference_response
from bench.systems import SDOF, BoucWen, Coulomb, Duffing, Pendulum, QuadraticDamping, System, VanDerPol

TIMES = np.linspace(0.0, 8.0, 33)
FORCE = Force(np.linspace(0.0, 8.0, 41), 3.0 * np.random.default_rng(4).standard_normal(41), "linear")

Response = Callable[[System, dict[str, float], InitialState, np.ndarray, Sequence[Force]], np.ndarray]


def simulated(
    system: System, p: dict[str, float], start: InitialState, t: np.ndarray, f: Sequence[Force] = ()
) -> np.ndarray:
    return simulate(system, p, start, t, f).displacement


both = pytest.mark.parametrize("response", [reference_response, simulated], ids=["truth", "simulate"])


def let_go(x: float) -> InitialState:
    return InitialState(np.array([x]), np.zeros(1))


@both
def test_the_undamped_duffing_oscillator_is_an_elliptic_cosine(response: Response) -> None:
    """``x = A cn(W t | k²)``, ``W² = (k + k3 A²)/m``, ``k² = k3 A² / 2 (k + k3 A²)`` (Nayfeh and Mook, section 2.1)."""
    p, a = {"m": 1.3, "c": 1e-14, "k": 8.0, "k3": 6.0}, 1.2
    w, modulus = math.sqrt((8.0 + 6.0 * a * a) / 1.3), 6.0 * a * a / (2 * (8.0 + 6.0 * a * a))
    expected = a * ellipj(w * TIMES, modulus)[1]
    np.testing.assert_allclose(response(Duffing(), p, let_go(a), TIMES, ())[0], expected, atol=2e-9)


@both
def test_the_undamped_pendulum_is_an_elliptic_sine_of_its_own_period(response: Response) -> None:
    """``sin(θ/2) = sin(θ0/2) sn(K + w t)``, period ``4 K / w`` with K at ``sin²(θ0/2)`` (Landau, Mechanics, §11)."""
    p, length = {"m": 0.7, "c": 1e-14, "k": 9.0, "l": 1.4}, 1.4
    w, theta = math.sqrt(9.0 / 0.7), 2.1
    modulus = math.sin(theta / 2) ** 2
    k = ellipk(modulus)
    expected = 2 * length * np.arcsin(math.sin(theta / 2) * ellipj(k + w * TIMES, modulus)[0])
    found = response(Pendulum(), p, let_go(theta * length), TIMES, ())[0]
    np.testing.assert_allclose(found, expected, atol=1e-8 * theta * length)
    after = response(Pendulum(), p, let_go(theta * length), np.array([0.0, 4 * k / w]), ())[0]
    assert after[1] == pytest.approx(theta * length, rel=1e-8)


@both
def test_dry_friction_takes_four_mu_over_k_off_the_amplitude_in_each_cycle(response: Response) -> None:
    """Linear decay of peaks for sign(v) (Inman, section 1.10); smoothed over a thousandth of the speed."""
    p = {"m": 1.0, "c": 1e-12, "k": 9.0, "mu": 0.3}
    period = 2 * math.pi / 3.0
    peaks = response(Coulomb(0.003), p, let_go(1.0), period * np.arange(6), ())[0]
    np.testing.assert_allclose(np.diff(peaks), -4 * 0.3 / 9.0, rtol=5e-3)


@both
def test_a_weak_van_der_pol_oscillator_ends_in_its_limit_cycle_by_the_averaged_equation(response: Response) -> None:
    """``A(t) = 2 / √(1 + (4/A0² - 1) e^(-mu t))`` in its own units (Nayfeh and Mook, section 3.1.6), to order mu."""
    mu, scale = 0.02, math.sqrt(0.5)  # m = k = 1, c = mu, c3 = 2 mu: x = y √(c/c3)
    p = {"m": 1.0, "c": mu, "k": 1.0, "c3": 2 * mu}
    times = np.linspace(0.0, 500.0, 20001)
    x = response(VanDerPol(), p, let_go(0.5 * scale), times, ())[0] / scale
    for start in (1000, 5000, 19000):
        peak = start + int(np.argmax(np.abs(x[start : start + 300])))
        expected = 2 / math.sqrt(1 + (4 / 0.25 - 1) * math.exp(-mu * times[peak]))
        assert abs(x[peak]) == pytest.approx(expected, rel=0.01)
    assert np.max(np.abs(x[-300:])) == pytest.approx(2.0, rel=1e-3)


@both
def test_hysteresis_that_is_next_to_none_is_a_spring(response: Response) -> None:
    """beta and gamma towards 0: z = x - x(0), a spring kz whose rest is where the motion starts."""
    p = {"m": 1.4, "c": 0.7, "k": 5.0, "kz": 6.0, "beta": 1e-12, "gamma": 1e-12}
    middle = 6.0 * 0.8 / 11.0  # 5 x + 6 (x - 0.8) = 11 (x - middle)
    expected = middle + closed_form({"m": 1.4, "c": 0.7, "k": 11.0}, 0.8 - middle, -0.5, TIMES)
    start = InitialState(np.array([0.8]), np.array([-0.5]))
    np.testing.assert_allclose(response(BoucWen(), p, start, TIMES, ())[0], expected, atol=2e-9)


def test_a_hysteretic_force_saturates_where_its_rate_vanishes() -> None:
    """A steady slide: ``z -> (beta + gamma)^(-1/n)`` (Wen 1976); here a soft spring is pulled 40 m one way."""
    for n in (1, 2):
        p = {"m": 1.0, "c": 1e-9, "k": 1e-9, "kz": 1e-6, "beta": 1.5, "gamma": 0.5}
        start = InitialState(np.zeros(1), np.array([4.0]))
        motion = simulate(BoucWen(n), p, start, np.array([0.0, 10.0]))
        assert motion.hidden[0, -1] == pytest.approx(2.0 ** (-1 / n), rel=1e-6)


ENERGY: dict[str, tuple[System, dict[str, float], Callable[..., np.ndarray], Callable[..., np.ndarray]]] = {
    "duffing": (
        Duffing(),
        {"m": 1.4, "c": 0.7, "k": 11.0, "k3": 6.0},
        lambda p, x: p["k"] * x**2 / 2 + p["k3"] * x**4 / 4,
        lambda p, x, v: p["c"] * v**2,
    ),
    "quadratic_damping": (
        QuadraticDamping(),
        {"m": 1.4, "c": 0.3, "k": 11.0, "c2": 0.6},
        lambda p, x: p["k"] * x**2 / 2,
        lambda p, x, v: p["c"] * v**2 + p["c2"] * np.abs(v) ** 3,
    ),
    "coulomb": (
        Coulomb(0.05),
        {"m": 1.4, "c": 0.3, "k": 11.0, "mu": 0.5},
        lambda p, x: p["k"] * x**2 / 2,
        lambda p, x, v: p["c"] * v**2 + p["mu"] * np.tanh(v / 0.05) * v,
    ),
    "van_der_pol": (
        VanDerPol(),
        {"m": 1.4, "c": 1.0, "k": 11.0, "c3": 4.0},
        lambda p, x: p["k"] * x**2 / 2,
        lambda p, x, v: (p["c3"] * x**2 - p["c"]) * v**2,
    ),
    "pendulum": (
        Pendulum(),
        {"m": 1.4, "c": 0.3, "k": 11.0, "l": 1.1},
        lambda p, x: p["k"] * p["l"] ** 2 * (1 - np.cos(x / p["l"])),
        lambda p, x, v: p["c"] * v**2,
    ),
    "bouc_wen": (
        BoucWen(1.5),
        {"m": 1.4, "c": 0.3, "k": 5.0, "kz": 6.0, "beta": 1.2, "gamma": 0.8},
        lambda p, x: p["k"] * x**2 / 2,
        lambda p, x, v, z: p["c"] * v**2 + p["kz"] * z * v,
    ),
}


@pytest.mark.parametrize("forces", [(), (FORCE,)], ids=["free", "forced"])
@pytest.mark.parametrize("name", ENERGY)
def test_work_done_is_energy_gained_and_dissipated(name: str, forces: tuple[Force, ...]) -> None:
    """``∫ f v dt = Δ(m v²/2 + U) + ∫ D dt``; the hysteretic spring's work counts as dissipated (it may come back).

    By the trapezium rule on a grid that holds the force's samples, Richardson-extrapolated.
    """
    system, p, potential, dissipated = ENERGY[name]
    start = InitialState(np.array([0.9]), np.array([-0.4]))
    t = np.linspace(0.0, 8.0, 40 * 64 + 1)
    motion = simulate(system, p, start, t, forces)
    x, v = motion.displacement[0], motion.velocity[0]
    push = forces[0](t) if forces else np.zeros(t.size)
    power = push * v - dissipated(p, x, v, *motion.hidden)
    coarse, fine = np.trapezoid(power[::2], t[::2]), np.trapezoid(power, t)
    energy = p["m"] * v**2 / 2 + potential(p, x)
    assert energy[-1] - energy[0] == pytest.approx((4 * fine - coarse) / 3, abs=2e-6 * np.max(energy))
    np.testing.assert_allclose(reference_response(system, p, start, t, forces)[0], x, atol=1e-8 * np.max(np.abs(x)))


def test_a_sensor_of_acceleration_feels_the_hidden_state_and_a_start_is_fitted_with_it() -> None:
    p = ENERGY["bouc_wen"][1]
    start = InitialState(np.array([0.9]), np.array([-0.4]))

    def rate(t: float, s: np.ndarray) -> list[float]:
        x, v, z = s
        z_rate = v - 1.2 * abs(v) * abs(z) ** 0.5 * z - 0.8 * v * abs(z) ** 1.5
        return [v, -(0.3 * v + 5.0 * x + 6.0 * z) / 1.4, z_rate]

    solution = solve_ivp(rate, (0, 8), [0.9, -0.4, 0.0], method="LSODA", t_eval=TIMES, rtol=1e-11, atol=1e-12)
    record = Record((Channel(TIMES, solution.y[0]), Channel(TIMES, np.zeros(33), "acceleration")))
    x, a = measurements(BoucWen(1.5), p, start, record).reshape(2, -1)
    np.testing.assert_allclose(x, solution.y[0], atol=1e-7)
    np.testing.assert_allclose(a, [rate(0.0, s)[1] for s in solution.y.T], atol=1e-6)
    found = fit_initial_state(BoucWen(1.5), p, Record((Channel(TIMES, solution.y[0]),)))
    assert found.displacement[0] == pytest.approx(0.9, abs=1e-3)
    assert found.velocity[0] == pytest.approx(-0.4, abs=1e-2)


def test_a_motion_that_diverges_is_nan_from_there_on() -> None:
    """Beyond ``x = √(k / |k3|)`` a softening spring lets go; before, the motion is the free one that scipy finds."""
    p = {"m": 1.0, "c": 0.1, "k": 1.0, "k3": -50.0}
    x = simulate(Duffing(), p, let_go(0.8), np.array([0.0, 0.05, 5.0])).displacement[0]
    assert np.isfinite(x[1])
    assert np.isnan(x[2])
    assert np.all(np.isfinite(simulate(SDOF(), {"m": 1.0, "c": 0.1, "k": 1.0}, let_go(0.8), TIMES).displacement))
