"""What ``system=auto`` chooses of records whose law is known: simulated by closed forms and by scipy, never by us."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bench.config.overrides import overrides_of
from bench.contract.problem import Channel, Problem, Record
from bench.likelihood.output_error import OutputError
from bench.records import classes
from bench.records.classes import LEVEL, ModelClass, best_class, ranked_classes
from bench.records.continued import continued_fit
from bench.records.find import find
from bench.records.held_out import HELD_OUT, held_out_fit
from bench.records.linearised import at_theta
from bench.records.reading import Recording, Signal
from bench.records.record import Measured, read_measured, with_system
from bench.records.request import request_of
from bench.records.zeros import without
from bench.systems.sums import Sum, sum_from

T = np.linspace(0.0, 9.0, 300)
OMEGA, ZETA = 2 * np.pi, 0.01
FRICTION = 0.01 * OMEGA**2
"""mu/m (m/s²): the body would stop where the spring is out by 0.01 m, and it never comes so near."""


def viscous() -> np.ndarray:
    damped = OMEGA * np.sqrt(1 - ZETA**2)
    return np.exp(-ZETA * OMEGA * T) * (np.cos(damped * T) + ZETA / np.sqrt(1 - ZETA**2) * np.sin(damped * T))


def with_friction() -> np.ndarray:
    """Let go at 1 m: each half period is a viscous decay about where friction and spring are even, in closed form."""
    damped = OMEGA * np.sqrt(1 - ZETA**2)
    half = np.pi / damped
    x, start, side = np.zeros_like(T), 1.0, 1.0
    for i in range(int(T[-1] / half) + 1):
        rest = side * FRICTION / OMEGA**2
        own = (i * half <= T) & ((i + 1) * half > T)
        t = T[own] - i * half
        decay = np.exp(-ZETA * OMEGA * t)
        x[own] = rest + (start - rest) * decay * (np.cos(damped * t) + ZETA * OMEGA / damped * np.sin(damped * t))
        start, side = rest - (start - rest) * np.exp(-ZETA * OMEGA * half), -side
    assert abs(start) > 10 * FRICTION / OMEGA**2  # nothing sticks
    return x


def integrated(spring, amplitude: float, zeta: float = ZETA) -> np.ndarray:  # type: ignore[no-untyped-def]
    """``x'' = -2 zeta OMEGA x' - spring(x)``, let go."""

    def law(t, y):  # type: ignore[no-untyped-def]
        return [y[1], -2 * zeta * OMEGA * y[1] - spring(y[0])]

    return solve_ivp(law, (0.0, T[-1]), [amplitude, 0.0], t_eval=T, rtol=1e-9, atol=1e-11).y[0]


def duffing() -> np.ndarray:
    return integrated(lambda x: OMEGA**2 * (x + 0.5 * x**3), 1.0)


def pendulum() -> np.ndarray:
    """An angle, let go at 1.6 rad."""
    return integrated(lambda x: OMEGA**2 * np.sin(x), 1.6)


def measured(x: np.ndarray, db: float, seed: int, unit: str = "m") -> Measured:
    noise = np.std(x) * 10 ** (-db / 20) * np.random.default_rng(seed).standard_normal(x.size)
    recording = Recording((Signal("x", "displacement", 0, x + noise, unit, T),), (), "simulated", "")
    request = request_of(overrides_of({"method": "output_error", "data": "simulated"}) | {"system": ["auto"]})
    return read_measured(request, (recording,))


def values(one: ModelClass) -> dict[str, float]:
    """Over the mass, in SI units."""
    p = one.at.model.parameters(one.at.theta)
    return {name: float(value) / one.at.model.gauge for name, value in p.items()}


def check_friction(db: float, seed: int) -> None:
    record = measured(with_friction(), db, seed)
    found = best_class(record)
    assert isinstance(found.problem.system, Sum)
    assert found.problem.system.terms == ("viscous", "spring", "coulomb"), found.notes
    assert any(note.startswith("system=auto chose") for note in found.notes)


def duffing_record(cycles: float) -> Measured:
    """Let go at 1 m, at 40 dB; twenty samples a cycle."""
    times = np.arange(round(20 * cycles)) / 20.0

    def law(t, y):  # type: ignore[no-untyped-def]
        return [y[1], -2 * ZETA * OMEGA * y[1] - OMEGA**2 * (y[0] + 0.5 * y[0] ** 3)]

    x = solve_ivp(law, (0.0, times[-1]), [1.0, 0.0], t_eval=times, rtol=1e-9, atol=1e-11).y[0]
    x = x + 0.01 * np.std(x) * np.random.default_rng(3).standard_normal(x.size)
    recording = Recording((Signal("x", "displacement", 0, x, "m", times),), (), "simulated", "")
    request = request_of(overrides_of({"method": "output_error", "data": "simulated"}) | {"system": ["auto"]})
    return read_measured(request, (recording,))


@pytest.mark.parametrize("cycles", [10.0, 40.0])
def test_the_fit_of_a_class_is_continued_to_the_whole_record(cycles: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """From twelve cycles of forty, or from the whole of a short record, to the law's parameters in SI units."""
    monkeypatch.setattr(classes, "_bases", lambda sprung: [])
    record = duffing_record(cycles)
    found = ranked_classes(record)
    best = next(one for one in found if one.name == "Duffing")
    outcome = continued_fit(best, with_system(record, best.system).problem)
    assert outcome is not None
    assert outcome.estimate is not None
    law = {"k_over_m": OMEGA**2, "c_over_m": 2 * ZETA * OMEGA, "k3_over_m": 0.5 * OMEGA**2}
    for name, value in law.items():
        marginal = outcome.estimate.marginal(best.system.quantity(name))
        assert marginal is not None
        low, high = marginal.interval(0.999)
        assert low < value < high
        assert high - low < 0.2 * value


def test_a_class_with_other_unknowns_is_not_continued(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(classes, "_bases", lambda sprung: [])
    record = duffing_record(10.0)
    best = next(one for one in ranked_classes(record) if one.name == "Duffing")
    assert continued_fit(best, with_system(record, sum_from("sdof")).problem) is None


@pytest.mark.slow
def test_friction_joins_the_second_of_what_pulls_back_too() -> None:
    """A pendulum of large swings with friction: without friction a softening spring may describe it as well."""
    x = integrated_pendulum_with_friction()
    names = [one.name for one in ranked_classes(measured(x, 40.0, 0, "rad"))]
    assert {"pendulum + Coulomb", "softening + Coulomb"} <= set(names)
    assert names[0].startswith("pendulum + Coulomb")


def integrated_pendulum_with_friction() -> np.ndarray:
    def law(t, y):  # type: ignore[no-untyped-def]
        return [y[1], -2 * ZETA * OMEGA * y[1] - OMEGA**2 * np.sin(y[0]) - FRICTION * np.tanh(y[1] / 1e-3)]

    return solve_ivp(law, (0.0, T[-1]), [1.6, 0.0], t_eval=T, rtol=1e-9, atol=1e-11, max_step=0.01).y[0]


@pytest.mark.slow
def test_friction_is_found() -> None:
    """And viscous damping alone is told from it."""
    record = measured(with_friction(), 30.0, 0)
    ranked = ranked_classes(record)
    found = {one.name: one for one in ranked}
    assert min(one.criterion for one in ranked) == 0.0
    assert [one.criterion for one in ranked] == sorted(one.criterion for one in ranked)
    assert found["viscous"].criterion > 10.0
    assert found["viscous + Coulomb"].criterion < 10.0
    assert found["viscous + Coulomb"].left == pytest.approx(10**-1.5, rel=0.15)
    assert found["viscous + Coulomb"].held_out == pytest.approx(100 * (1 - 0.05), abs=5)
    assert found["viscous"].held_out < found["viscous + Coulomb"].held_out
    p, units = values(found["viscous + Coulomb"]), record.problem.natural_units()
    mu = next(q for q in found["viscous + Coulomb"].system.parameters if q.name == "mu")
    m = next(q for q in found["viscous + Coulomb"].system.parameters if q.name == "m")
    scale = units.of(mu.dimension) / units.of(m.dimension)
    assert p["mu"] / p["m"] * scale == pytest.approx(FRICTION, rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("db", [30.0, 40.0])
@pytest.mark.parametrize("seed", [0, 1])
def test_friction_is_chosen(db: float, seed: int) -> None:
    check_friction(db, seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 10])
def test_in_much_noise_friction_is_chosen_or_said_not_to_be_told_apart(seed: int) -> None:
    """At 20 dB the viscous class is as good in some records, by less than 2 of the criterion."""
    found = best_class(measured(with_friction(), 20.0, seed))
    assert isinstance(found.problem.system, Sum)
    said = next(note for note in found.notes if note.startswith("system=auto chose"))
    assert "coulomb" in said or "viscous + Coulomb" in said


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_viscous_damping_is_chosen_alone_and_the_rest_is_nothing_or_not_told_apart(seed: int) -> None:
    found = best_class(measured(viscous(), 30.0, seed))
    assert isinstance(found.problem.system, Sum)
    assert found.problem.system.terms == ("viscous", "spring"), found.notes
    said = next(note for note in found.notes if note.startswith("system=auto chose"))
    assert "Coulomb" in said or any("mu/m is 0, at most" in note for note in found.notes)


@pytest.mark.slow
def test_the_most_friction_that_a_viscous_record_allows_is_far_below_what_would_be_seen() -> None:
    """Beside viscous damping alone below a tenth of what is found above; beside more it is told less well."""
    found = {one.name: one for one in ranked_classes(measured(viscous(), 40.0, 0))}
    assert 0 < found["viscous + Coulomb"].zero["mu"] < 0.1 * FRICTION


@pytest.mark.slow
@pytest.mark.parametrize("db", [20.0, 40.0])
def test_a_hardening_spring_is_chosen(db: float) -> None:
    record = measured(duffing(), db, 3)
    ranked = ranked_classes(record)
    assert next(one for one in ranked if one.name == "Duffing").criterion < LEVEL
    assert next(one for one in ranked if one.name == "viscous").criterion > 100.0
    found = best_class(record)
    assert isinstance(found.problem.system, Sum)
    assert found.problem.system.terms == ("viscous", "spring", "cubic"), found.notes


@pytest.mark.slow
@pytest.mark.parametrize("db", [20.0, 40.0])
def test_a_pendulum_of_large_swings_is_chosen_by_its_angle(db: float) -> None:
    record = measured(pendulum(), db, 4, "rad")
    assert record.angle
    found = best_class(record)
    system = found.problem.system
    assert isinstance(system, Sum)
    assert system.terms == ("viscous", "pendulum"), found.notes
    assert dict(system.fixed) == {"l": 1.0}


def test_two_sensors_have_no_classes_and_it_is_said() -> None:
    record = measured(viscous(), 30.0, 0)
    signals = tuple(
        Signal(role, measures, 0, np.array(viscous()), unit, T)
        for role, measures, unit in [("x", "displacement", "m"), ("v", "velocity", "m/s")]
    )
    request = request_of(overrides_of({"method": "output_error", "data": "simulated"}) | {"system": ["auto"]})
    both = read_measured(request, (Recording(signals, (), "simulated", ""),))
    assert ranked_classes(both) == []
    found = best_class(both)
    assert found.problem is both.problem
    assert "sdof is used" in found.notes[-1]
    assert record.notes == ()


def test_a_sum_loses_the_terms_that_are_nothing_but_never_all() -> None:
    assert without(sum_from("sdof+coulomb+quadratic"), {"mu": 0.1}).terms == ("viscous", "spring", "quadratic")
    assert without(sum_from("viscous"), {"c": 0.1}).terms == ("viscous",)


@pytest.mark.parametrize("more", [0.0, 0.2])
def test_the_held_out_fit_is_what_a_direct_computation_gives(more: float) -> None:
    """Least squares of the first 60 % by scipy on the closed form, of the last 40 % of a motion that may change."""
    from scipy.optimize import least_squares

    x = viscous() * np.where(T > 5.4, 1.0 - more, 1.0) + 0.03 * np.random.default_rng(8).standard_normal(T.size)
    problem = Problem(sum_from("sdof"), (Record((Channel(T, x, offset=True),)),))
    model = OutputError(problem)
    at = at_theta(model, model.settle(model.vector({"m": 1.0, "c": 2 * ZETA * OMEGA, "k": OMEGA**2})[None])[0])
    assert at is not None
    early = (1 - HELD_OUT) * T[-1] >= T

    def closed(q: np.ndarray) -> np.ndarray:
        rate, decay, a, b, offset = q
        return np.exp(-decay * T) * (a * np.cos(rate * T) + b * np.sin(rate * T)) + offset

    first = np.array([OMEGA, ZETA * OMEGA, 1.0, 0.0, 0.0])
    q = least_squares(lambda q: (closed(q) - x)[early], first, xtol=1e-12, ftol=1e-12).x
    late = x[~early]
    direct = 100 * (1 - np.linalg.norm(late - closed(q)[~early]) / np.linalg.norm(late - np.mean(late)))
    assert held_out_fit(at) == pytest.approx(direct, abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["shooting", "output_error"])
def test_friction_that_a_record_has_no_use_for_is_zero_in_the_answer_of_any_method(method: str) -> None:
    """Of a body with air drag, whose damping falls with the amplitude where friction's would rise."""

    def law(t, y):  # type: ignore[no-untyped-def]
        return [y[1], -(OMEGA**2) * y[0] - 0.1 * abs(y[1]) * y[1]]

    x = solve_ivp(law, (0.0, T[-1]), [1.0, 0.0], t_eval=T, rtol=1e-9, atol=1e-11).y[0]
    x = x + 0.01 * np.random.default_rng(0).standard_normal(x.size)
    recording = Recording((Signal("x", "displacement", 0, x, "m", T),), (), "simulated", "")
    request = request_of(overrides_of({"method": method, "data": "simulated"}) | {"system": ["sdof+coulomb"]})
    found = find(request.jobs[0], read_measured(request, (recording,)))
    assert any("mu/m is 0, at most" in reason.text for reason in found.reasons)
    mu = found.intervals["mu_over_m"]
    assert (mu.value, mu.low) == (0.0, 0.0)
    assert 0.0 < mu.high < 0.1 * OMEGA**2
    assert found.intervals["k_over_m"].low < OMEGA**2 < found.intervals["k_over_m"].high
