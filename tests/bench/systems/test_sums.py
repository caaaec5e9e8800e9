"""Sums of terms: the laws of the systems that they are taken from, what is told of them, and fits of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bench import Channel, Force, InputError, Problem, Record, numpy_ops
from bench.entrants.registry import make_method
from bench.information.structural import structure
from bench.systems import SDOF, Coulomb, Duffing, Pendulum, QuadraticDamping, System
from bench.systems.sums import Sum, sum_from

ALIKE: dict[str, tuple[Sum, System]] = {
    "sdof": (Sum(("viscous", "spring")), SDOF()),
    "coulomb": (Sum(("viscous", "spring", "coulomb"), 0.3), Coulomb(0.3)),
    "quadratic_damping": (Sum(("viscous", "spring", "quadratic")), QuadraticDamping()),
    "duffing": (Sum(("viscous", "spring", "cubic")), Duffing()),
    "pendulum": (Sum(("viscous", "pendulum")), Pendulum()),
}
MIXED = {
    "all damping": Sum(("viscous", "spring", "coulomb", "quadratic"), 0.3),
    "softening": Sum(("viscous", "spring", "softening")),
    "pendulum of a told length": Sum(("pendulum", "viscous", "coulomb"), 0.3, (("l", 0.7),)),
    "driven axis": Sum(("viscous", "coulomb", "bias"), 0.3, bias_sign=-1),
    "told stiffness": Sum(("viscous", "spring", "cubic"), fixed=(("k", 8.0),)),
}
EVERY = {**{name: own for name, (own, _) in ALIKE.items()}, **MIXED}


def drawn(system: System, seed: int = 7) -> tuple[dict[str, float], list[np.ndarray]]:
    """Random parameters and one random state x, v, a, f, each of shape (1,)."""
    rng = np.random.default_rng(seed)
    return {name: float(rng.uniform(0.5, 2.0)) for name in system.names}, list(rng.standard_normal((4, 1)))


@pytest.mark.parametrize("name", ALIKE)
def test_a_sum_is_the_system_of_the_same_terms(name: str) -> None:
    own, theirs = ALIKE[name]
    p, motion = drawn(theirs)
    assert own.parameters == theirs.parameters
    assert own.groups == theirs.groups
    assert own.gauge == theirs.gauge
    declared = ("linear", "smooth", "affine_in_parameters")
    assert [getattr(own, d) for d in declared] == [getattr(theirs, d) for d in declared]
    np.testing.assert_allclose(own.residual(p, *motion, [], numpy_ops), theirs.residual(p, *motion, [], numpy_ops))


def test_the_other_terms_by_hand() -> None:
    p, (x, v, a, f) = drawn(Sum(("viscous", "spring", "softening", "bias")))
    for sign in (1, -1):
        (r,) = Sum(("viscous", "spring", "softening", "bias"), bias_sign=sign).residual(p, x, v, a, f, [], numpy_ops)
        expected = p["m"] * a + p["c"] * v + p["k"] * x - p["k3s"] * x**3 + sign * p["b"] - f
        np.testing.assert_allclose([r], [expected[0]])


def test_linear_sums_have_the_oscillators_modal_quantities_and_others_what_their_parameters_give() -> None:
    assert Sum(("viscous", "spring")).modal == SDOF().modal
    assert [q.name for q in Sum(("spring", "coulomb")).modal] == ["natural_frequency"]
    assert Sum(("viscous", "coulomb")).modal == ()
    assert [q.name for q in MIXED["told stiffness"].groups] == ["c_over_m", "k3_over_m"]


@pytest.mark.parametrize("name", [n for n in EVERY if not EVERY[n].needs_scale])
def test_free_vibration_tells_the_declared_groups_by_exact_algebra(name: str) -> None:
    found = structure(EVERY[name])
    assert found.rank == len(EVERY[name].groups)
    assert all(found.identifiable(group) for group in EVERY[name].groups)


def test_a_told_stiffness_tells_the_mass() -> None:
    """Why ``needs_scale`` is said: a method that holds the mass at 1 in free vibration would be wrong."""
    system = MIXED["told stiffness"]
    assert system.needs_scale
    assert structure(system).rank == len(system.names)


def test_an_offset_is_told_where_something_pulls_back_and_no_bias_does() -> None:
    assert Sum(("viscous", "spring")).offset_identifiable
    assert not Sum(("viscous", "coulomb")).offset_identifiable
    assert not Sum(("viscous", "spring", "bias")).offset_identifiable


def test_what_means_the_same_is_equal() -> None:
    told: Any = {"k": 0.0}
    axis = Sum(("viscous", "coulomb"))
    assert Sum(("coulomb", "viscous")) == axis
    assert Sum(("coulomb", "spring", "viscous"), fixed=told) == axis
    assert Sum(("coulomb", "viscous", "pendulum"), fixed=(("l", 1.0), ("k", 0.0))) == axis
    assert Sum(["viscous", "coulomb"], fixed=[]) == axis


PARSED = {
    "sdof": ("viscous", "spring"),
    "sdof+coulomb+quadratic": ("viscous", "spring", "quadratic", "coulomb"),
    "coulomb": ("viscous", "spring", "coulomb"),
    "coulomb+quadratic": ("viscous", "spring", "quadratic", "coulomb"),
    "quadratic_damping + coulomb": ("viscous", "spring", "quadratic", "coulomb"),
    "duffing": ("viscous", "spring", "cubic"),
    "pendulum+coulomb": ("viscous", "pendulum", "coulomb"),
    "pendulum+viscous": ("viscous", "pendulum"),
    "viscous+coulomb+bias": ("viscous", "coulomb", "bias"),
    "SDOF+softening": ("viscous", "spring", "softening"),
}


@pytest.mark.parametrize("text", PARSED)
def test_what_a_user_writes(text: str) -> None:
    assert sum_from(text) == Sum(PARSED[text])


BAD: dict[str, tuple[Callable[[], Sum], str]] = {
    "an unknown term": (lambda: Sum(("viscous", "magnet")), "terms=magnet: known terms: viscous, spring"),
    "a term twice": (lambda: Sum(("viscous", "viscous")), "terms=viscous: the term is repeated"),
    "no term": (lambda: Sum(()), "name at least one"),
    "two springs": (lambda: Sum(("spring", "pendulum")), "spring, pendulum: these terms exclude each other"),
    "two signs": (lambda: Sum(("spring", "cubic", "softening")), "cubic, softening: these terms exclude each other"),
    "nothing left": (lambda: Sum(("spring",), fixed=(("k", 0.0),)), "terms=spring: name at least one"),
    "a fixed mass": (lambda: Sum(("spring",), fixed=(("m", 1.0),)), "fixed.m=1.0: the mass cannot be fixed"),
    "a fixed parameter of no term": (
        lambda: Sum(("spring",), fixed=(("mu", 1.0),)),
        "fixed.mu=1.0: parameters of these terms: k",
    ),
    "a negative value": (lambda: Sum(("spring",), fixed=(("k", -1.0),)), "0 or more"),
    "length 0": (lambda: Sum(("pendulum",), fixed=(("l", 0.0),)), "a finite number, positive"),
    "a value that is not finite": (lambda: Sum(("spring",), fixed=(("k", float("nan")),)), "a finite number"),
    "a value twice": (lambda: Sum(("spring",), fixed=(("k", 1.0), ("k", 2.0))), "is repeated"),
    "no pairs": (lambda: Sum(("spring",), fixed=("k",)), "write names and values"),
    "no smoothing": (lambda: Sum(("coulomb",), 0.0), "smoothing_velocity=0.0: a positive velocity"),
    "a bias of 2": (lambda: Sum(("bias",), bias_sign=2), "bias_sign=2: 1 or -1"),
    "an unknown word": (lambda: sum_from("sdof+magnet"), "system=sdof+magnet: magnet is unknown"),
    "an empty word": (lambda: sum_from("sdof+"), "an empty word is unknown"),
    "a word twice": (lambda: sum_from("sdof+coulomb+coulomb"), "coulomb is repeated"),
    "an unknown option": (lambda: sum_from("sdof", exponent=2), "exponent"),
    "a pendulum with a spring": (lambda: sum_from("sdof+pendulum"), "spring, pendulum: these terms exclude each other"),
}


@pytest.mark.parametrize("what", BAD)
def test_what_makes_no_sense_is_refused_in_one_line(what: str) -> None:
    make, part = BAD[what]
    with pytest.raises(InputError) as caught:
        make()
    assert part in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


K = 39.5


def pushed(t: float) -> float:
    """Three sines (N) that drive the axis."""
    return float(sum(60.0 * np.sin(2 * np.pi * f * t + phase) for f, phase in ((0.5, 0.3), (1.25, 2.0), (2.0, 4.0))))


FITS: dict[str, tuple[Sum, Callable[[float, float, float], float], dict[str, float]]] = {
    "Coulomb": (
        Sum(("viscous", "spring", "coulomb"), 0.02),
        lambda t, x, v: -K * x - 0.15 * v - 0.5 * np.tanh(v / 0.02),
        {"k_over_m": K, "c_over_m": 0.15, "mu_over_m": 0.5},
    ),
    "Duffing": (
        Sum(("viscous", "spring", "cubic")),
        lambda t, x, v: -K * x - 15.0 * x**3 - 0.15 * v,
        {"k_over_m": K, "c_over_m": 0.15, "k3_over_m": 15.0},
    ),
    "pendulum in radians": (
        Sum(("viscous", "pendulum", "coulomb"), 0.02, (("l", 1.0),)),
        lambda t, x, v: -K * np.sin(x) - 0.15 * v - 0.5 * np.tanh(v / 0.02),
        {"k_over_m": K, "c_over_m": 0.15, "mu_over_m": 0.5},
    ),
    "driven axis": (
        Sum(("viscous", "spring", "coulomb", "bias"), 0.02, (("k", 0.0),), -1),
        lambda t, x, v: (pushed(t) - 200.0 * v - 20.0 * np.tanh(v / 0.02) + 3.0) / 95.0,
        {"m": 95.0, "c": 200.0, "mu": 20.0, "b": 3.0},
    ),
}


def simulated(name: str) -> Problem:
    """300 samples at 40 dB over 8 s by SciPy's integrator, with an unknown start."""
    system, acceleration, _ = FITS[name]
    times, start = np.linspace(0.0, 8.0, 300), [0.0 if name == "driven axis" else 1.0, 0.0]
    path = solve_ivp(lambda t, s: [s[1], acceleration(t, *s)], (0.0, 8.0), start, "LSODA", times, rtol=1e-9, atol=1e-11)
    x = path.y[0] + 0.01 * np.sqrt(np.mean(path.y[0] ** 2)) * np.random.default_rng(1).standard_normal(300)
    fine = np.linspace(0.0, 8.0, 1200)
    force = Force(fine, np.array([pushed(t) for t in fine]))
    return Problem(system, (Record((Channel(times, x),), (force,) if name == "driven axis" else ()),))


def check_fit(name: str, method: str) -> None:
    estimate = make_method(method, {}).identify(simulated(name), np.random.default_rng(0))
    for quantity, truth in FITS[name][2].items():
        marginal = estimate.marginal(FITS[name][0].quantity(quantity))
        assert marginal is not None, estimate.message
        low, high = marginal.interval(0.95)
        assert abs(marginal.value - truth) < max(high - low, 0.01 * truth), quantity  # four standard errors


@pytest.mark.parametrize("name", FITS)
def test_shooting_finds_a_sum(name: str) -> None:
    pytest.importorskip("casadi")
    check_fit(name, "shooting")


@pytest.mark.slow
@pytest.mark.parametrize("name", FITS)
def test_output_error_finds_a_sum(name: str) -> None:
    check_fit(name, "output_error")
