"""Selection of model classes by ``system=auto``, on records simulated by closed forms and by scipy."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bench.config.overrides import overrides_of
from bench.contract.problem import Channel, Problem, Record
from bench.likelihood.output_error import OutputError
from bench.records.classes import best_class, compare_classes, needless_terms
from bench.records.identification import identify
from bench.records.linearised_fit import at_theta
from bench.records.models import ClassComparison
from bench.records.prediction import HELD_OUT, held_out_fit
from bench.records.problem import Measured, read_measured
from bench.records.reading import Recording, Signal
from bench.records.request import request_of
from bench.systems.sums import Sum, sum_from

T = np.linspace(0.0, 9.0, 300)
OMEGA, ZETA = 2 * np.pi, 0.01
FRICTION = 0.01 * OMEGA**2
"""mu/m (m/s²): the mass sticks within 0.01 m of its equilibrium, which the records do not reach."""


def viscous() -> np.ndarray:
    damped = OMEGA * np.sqrt(1 - ZETA**2)
    return np.exp(-ZETA * OMEGA * T) * (np.cos(damped * T) + ZETA / np.sqrt(1 - ZETA**2) * np.sin(damped * T))


def with_friction() -> np.ndarray:
    """Return a free decay from 1 m: each half period is a viscous decay about a shifted equilibrium, in closed form."""
    damped = OMEGA * np.sqrt(1 - ZETA**2)
    half = np.pi / damped
    x, start, side = np.zeros_like(T), 1.0, 1.0
    for i in range(int(T[-1] / half) + 1):
        rest = side * FRICTION / OMEGA**2
        part = (i * half <= T) & ((i + 1) * half > T)
        t = T[part] - i * half
        decay = np.exp(-ZETA * OMEGA * t)
        x[part] = rest + (start - rest) * decay * (np.cos(damped * t) + ZETA * OMEGA / damped * np.sin(damped * t))
        start, side = rest - (start - rest) * np.exp(-ZETA * OMEGA * half), -side
    assert abs(start) > 10 * FRICTION / OMEGA**2  # nothing sticks
    return x


def integrated(force: Callable[[float, float], float], amplitude: float) -> np.ndarray:
    """Return the free decay of ``x'' = -2 ZETA OMEGA x' - force(x, x')`` from rest."""

    def law(t: float, y: np.ndarray) -> list[float]:
        return [y[1], -2 * ZETA * OMEGA * y[1] - force(*y)]

    return solve_ivp(law, (0.0, T[-1]), [amplitude, 0.0], t_eval=T, rtol=1e-9, atol=1e-11, max_step=0.01).y[0]


def duffing() -> np.ndarray:
    return integrated(lambda x, v: OMEGA**2 * (x + 0.5 * x**3), 1.0)


def pendulum(friction: float = 0.0) -> np.ndarray:
    """Return the angle of a pendulum released at 1.6 rad."""
    return integrated(lambda x, v: OMEGA**2 * np.sin(x) + friction * np.tanh(v / 1e-3), 1.6)


KINDS = {"displacement": ("x", "m"), "velocity": ("v", "m/s"), "acceleration": ("a", "m/s²")}


def records(system: str, *signals: Signal) -> Measured:
    """Return signals as separate records."""
    request = request_of(overrides_of({"method": "output_error", "data": "simulated"}) | {"system": [system]})
    return read_measured(request, tuple(Recording((signal,), (), "simulated", "") for signal in signals))


def noisy(
    x: np.ndarray, db: float, seed: int, unit: str = "m", measures: str = "displacement", t: np.ndarray = T
) -> Signal:
    noise = np.std(x) * 10 ** (-db / 20) * np.random.default_rng(seed).standard_normal(x.size)
    role = KINDS[measures][0]
    return Signal(role, measures, 0, x + noise, unit, t)  # type: ignore[arg-type]


def measured(x: np.ndarray, db: float, seed: int, unit: str = "m", measures: str = "displacement") -> Measured:
    return records("auto", noisy(x, db, seed, unit, measures))


def compared(record: Measured) -> ClassComparison:
    comparison = compare_classes(record)
    assert comparison is not None
    return comparison


def chosen(record: Measured) -> tuple[str, ...]:
    return compared(record).chosen.system.terms


def motion_with_friction() -> dict[str, np.ndarray]:
    """Return displacement, velocity and acceleration of the decay with friction."""
    x = with_friction()
    fine = np.linspace(0.0, T[-1], 20 * (T.size - 1) + 1)

    def law(t, y):  # type: ignore[no-untyped-def]
        return [y[1], -2 * ZETA * OMEGA * y[1] - OMEGA**2 * y[0] - FRICTION * np.tanh(y[1] / 1e-3)]

    y = solve_ivp(law, (0.0, T[-1]), [1.0, 0.0], t_eval=fine, rtol=1e-9, atol=1e-11, max_step=0.01).y[:, ::20]
    assert np.max(np.abs(y[0] - x)) < 1e-3
    a = -2 * ZETA * OMEGA * y[1] - OMEGA**2 * y[0] - FRICTION * np.tanh(y[1] / 1e-3)
    return {"displacement": x, "velocity": y[1], "acceleration": a}


@pytest.mark.parametrize("measures", list(KINDS))
def test_friction_is_chosen_by_any_sensor(measures: str) -> None:
    """Its parameters are those of the closed form within a few standard errors at 30 dB."""
    comparison = compared(measured(motion_with_friction()[measures], 30.0, 0, KINDS[measures][1], measures))
    assert comparison.chosen.system.terms == ("viscous", "spring", "coulomb")
    assert comparison.chosen.parameters["k"] == pytest.approx(OMEGA**2, rel=0.003)
    assert comparison.chosen.parameters["mu"] == pytest.approx(FRICTION, rel=0.12)
    assert comparison.chosen.left == pytest.approx(10**-1.5, rel=0.35)  # dense samples are averaged
    viscous = next(model for model in comparison.classes if model.name == "viscous")
    assert viscous.told_apart
    assert viscous.left > comparison.chosen.left


@pytest.mark.slow
def test_repeats_have_a_common_class_which_is_that_of_each() -> None:
    x = with_friction()
    signals = [noisy((1.0 + 0.1 * i) * x, 40.0, i) for i in range(3)]
    assert compared(records("auto", *signals)).chosen.name == "viscous + Coulomb"
    assert all(compared(records("auto", signal)).chosen.name == "viscous + Coulomb" for signal in signals)


@pytest.mark.parametrize("colour", [0.0, 0.95])
def test_viscous_damping_is_selected_and_friction_has_a_limit(colour: float) -> None:
    """The noise is white or has an autocorrelation of 0.95, which a larger class may fit."""
    rng, noise = np.random.default_rng(0), np.zeros(T.size)
    for i in range(1, T.size):
        noise[i] = colour * noise[i - 1] + np.sqrt(1 - colour**2) * rng.standard_normal()
    record = records("auto", Signal("x", "displacement", 0, viscous() + 0.005 * noise, "m", T))
    comparison = compared(record)
    selected = best_class(record, comparison)
    assert isinstance(selected.problem.system, Sum)
    assert selected.problem.system.terms == ("viscous", "spring"), selected.notes
    assert selected.comparison is comparison
    assert any("mu/m is zero, at most" in note for note in selected.notes)
    assert 0 < comparison.chosen.zero["mu"] < (0.3 if colour else 0.15) * FRICTION


@pytest.mark.parametrize("db", [20.0, pytest.param(40.0, marks=pytest.mark.slow)])
def test_a_hardening_spring_is_chosen(db: float) -> None:
    comparison = compared(measured(duffing(), db, 3))
    assert comparison.chosen.name == "Duffing"
    assert comparison.chosen.parameters["k3"] == pytest.approx(0.5 * OMEGA**2, rel=0.1 if db < 30 else 0.02)
    assert min(model.criterion for model in comparison.classes) == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("db", [20.0, 40.0])
def test_a_pendulum_of_large_swings_is_chosen_by_its_angle(db: float) -> None:
    record = measured(pendulum(), db, 4, "rad")
    assert record.angle
    system = compared(record).chosen.system
    assert system.terms == ("viscous", "pendulum")
    assert dict(system.fixed) == {"l": 1.0}


@pytest.mark.slow
def test_friction_joins_a_pendulum() -> None:
    assert chosen(measured(pendulum(FRICTION), 40.0, 0, "rad")) == ("viscous", "pendulum", "coulomb")


@pytest.mark.slow
def test_friction_is_selected_from_windows_of_a_long_record() -> None:
    """Three windows of ninety cycles are fitted; the motion is in closed form, half period by half period."""
    times = np.arange(2160) / 24.0
    half, friction = np.pi / OMEGA, 0.002
    swing = 1.0 - 2.0 * friction * np.floor(times / half)  # twice the shift per half period
    side = (-1.0) ** np.floor(times / half)
    x = side * (friction + (swing - friction) * np.cos(OMEGA * (times % half)))
    comparison = compared(records("auto", noisy(x, 40.0, 1, t=times)))
    assert comparison.chosen.system.terms[-1] == "coulomb"
    assert comparison.chosen.parameters["mu"] == pytest.approx(friction * OMEGA**2, rel=0.1)


@pytest.mark.slow
def test_a_driven_axis_has_friction_and_no_spring() -> None:
    """``x'' = f - 2 x' - 3 sgn(x')`` with an alternating force is integrated by scipy."""
    times = np.linspace(0.0, 12.0, 600)
    force = 10.0 * np.sign(np.sin(2 * np.pi * times / 4.0 + 1e-9)) + 2.0 * np.sin(5.0 * times)

    def law(t, y):  # type: ignore[no-untyped-def]
        return [y[1], np.interp(t, times, force) - 2.0 * y[1] - 3.0 * np.tanh(y[1] / 1e-2)]

    x = solve_ivp(law, (0.0, 12.0), [0.0, 0.0], t_eval=times, rtol=1e-8, atol=1e-10, max_step=0.01).y[0]
    rng = np.random.default_rng(2)
    signals = (
        Signal("x", "displacement", 0, x + 0.005 * np.std(x) * rng.standard_normal(x.size), "m", times),
        Signal("f", "force", 0, force, "N", times),
    )
    request = request_of(overrides_of({"method": "output_error", "data": "simulated"}) | {"system": ["auto"]})
    model = compared(read_measured(request, (Recording(signals, (), "simulated", ""),))).chosen
    assert model.system.terms[:2] == ("viscous", "coulomb")
    assert "spring" not in model.system.terms
    assert model.parameters["m"] == pytest.approx(1.0, rel=0.03)
    assert model.parameters["mu"] == pytest.approx(3.0, rel=0.05)


def test_the_absence_of_classes_for_two_masses_is_reported() -> None:
    from bench.systems import make_system

    record = measured(viscous(), 30.0, 0)
    two = Problem(make_system("chain", {"n": 2}), record.problem.records)
    assert compare_classes(Measured(record.recordings, two, ())) is None
    selected = best_class(record, None)
    assert selected.problem is record.problem
    assert "system=sdof is used" in selected.notes[-1]


def drag() -> np.ndarray:
    """Return a motion with drag alone, which decreases with the amplitude, while the effect of friction increases."""
    return integrated(lambda x, v: OMEGA**2 * x + 0.1 * abs(v) * v - 2 * ZETA * OMEGA * v, 1.0)


def test_terms_with_a_negative_estimate_are_needless() -> None:
    """The friction of a sum is needless for quadratic damping, but not for a record with friction."""
    limits = needless_terms(records("sdof+coulomb", noisy(drag(), 37.0, 0)))
    assert list(limits) == ["mu"]
    assert 0.0 < limits["mu"] < 0.1 * OMEGA**2
    assert needless_terms(records("sdof+coulomb", noisy(with_friction(), 40.0, 0))) == {}


@pytest.mark.slow
@pytest.mark.parametrize("method", ["shooting", "output_error"])
def test_needless_friction_has_a_limit_with_any_method(method: str) -> None:
    request = request_of(overrides_of({"method": method, "data": "simulated"}) | {"system": ["sdof+coulomb"]})
    recording = Recording((noisy(drag(), 37.0, 0),), (), "simulated", "")
    finding = identify(request.jobs[0], read_measured(request, (recording,)))
    mu = finding.intervals["mu_over_m"]
    assert (mu.low, mu.limit) == (0.0, "at most")
    assert mu.value < 1e-3
    assert 0.0 < mu.high < 0.1 * OMEGA**2
    assert finding.intervals["k_over_m"].low < OMEGA**2 < finding.intervals["k_over_m"].high


@pytest.mark.parametrize("more", [0.0, 0.2])
def test_the_held_out_fit_equals_a_direct_computation(more: float) -> None:
    """The closed form is fitted to the first 60 % by scipy; the amplitude of the last 40 % may differ."""
    from scipy.optimize import least_squares

    x = viscous() * np.where(T > 5.4, 1.0 - more, 1.0) + 0.03 * np.random.default_rng(8).standard_normal(T.size)
    problem = Problem(sum_from("sdof"), (Record((Channel(T, x, offset=True),)),))
    model = OutputError(problem)
    fit = at_theta(model, model.settle(model.vector({"m": 1.0, "c": 2 * ZETA * OMEGA, "k": OMEGA**2})[None])[0])
    assert fit is not None
    early = (1 - HELD_OUT) * T[-1] >= T

    def closed(q: np.ndarray) -> np.ndarray:
        rate, decay, a, b, offset = q
        return np.exp(-decay * T) * (a * np.cos(rate * T) + b * np.sin(rate * T)) + offset

    first = np.array([OMEGA, ZETA * OMEGA, 1.0, 0.0, 0.0])
    q = least_squares(lambda q: (closed(q) - x)[early], first, xtol=1e-12, ftol=1e-12).x
    late = x[~early]
    direct = 100 * (1 - np.linalg.norm(late - closed(q)[~early]) / np.linalg.norm(late - np.mean(late)))
    assert held_out_fit(fit) == pytest.approx(direct, abs=0.05)
