"""Modes against closed forms and another solver."""

import math

import numpy as np
import pytest
from scipy.linalg import eigh

from bench.dynamics.mechanics import linear_matrices
from bench.dynamics.modal import Modes, agreement, mac, modes, modes_of_all
from bench.systems import SDOF, Chain

CHAIN = {"m1": 1.0, "m2": 0.9, "m3": 1.1, "k1": 20.0, "k2": 18.0, "k3": 22.0}


def _chain(beta: float) -> dict[str, float]:
    """Chain of three masses with ``c_i = beta k_i``: damping proportional to the stiffness."""
    return CHAIN | {f"c{i}": beta * CHAIN[f"k{i}"] for i in (1, 2, 3)}


def test_one_mass_is_the_text_book_oscillator():
    found = modes(SDOF(), {"m": 2.0, "c": 0.8, "k": 50.0})
    assert found.frequencies == pytest.approx([5.0 / (2 * np.pi)])  # sqrt(50/2) = 5 rad/s
    assert found.damping_ratios == pytest.approx([0.8 / (2 * np.sqrt(100.0))])


def test_stiffness_proportional_damping_has_the_modes_of_the_undamped_chain():
    """C = beta K: mode i keeps shape and frequency, with damping ratio ``beta ω_i / 2`` (Rayleigh)."""
    beta, system = 0.01, Chain(3)
    found = modes(system, _chain(beta))
    mass, _, stiffness = linear_matrices(system, _chain(beta))
    squares, shapes = eigh(stiffness, mass)
    omega = np.sqrt(squares)
    np.testing.assert_allclose(found.frequencies, omega / (2 * np.pi), rtol=1e-10)
    np.testing.assert_allclose(found.damping_ratios, beta * omega / 2, rtol=1e-9)
    np.testing.assert_allclose(np.diag(mac(found.shapes, shapes)), 1.0, rtol=1e-9)


def test_an_overdamped_mode_is_one_mode():
    """Rates -1 and -4 per second: ``ω = 2`` rad/s, ``ζ = (1 + 4) / (2 * 2) = 1.25``."""
    found = modes(SDOF(), {"m": 1.0, "c": 5.0, "k": 4.0})
    assert found.frequencies == pytest.approx([2.0 / (2 * np.pi)])
    assert found.damping_ratios == pytest.approx([1.25])


def test_each_of_many_has_the_modes_that_it_has_alone():
    """Among them an overdamped one, and one that is not finite."""
    c, masses = np.array([0.8, 5.0, np.nan]), np.ones(3)
    found = modes_of_all(SDOF(), {"m": masses, "c": c, "k": 4.0 * masses})
    assert found.frequencies[:, 0] == pytest.approx([1 / np.pi, 1 / np.pi, np.nan], nan_ok=True)
    assert found.damping_ratios[:, 0] == pytest.approx([0.2, 1.25, np.nan], nan_ok=True)


def test_agreement_matches_modes_by_shape_not_by_order():
    """Two close modes whose identified frequencies have changed places: shapes say which is which."""
    shapes = np.array([[1.0, 1.0], [1.0, -1.0]])
    true = Modes(np.array([1.0, 1.01]), np.array([0.02, 0.04]), shapes)
    swapped = Modes(np.array([1.005, 1.02]), np.array([0.04, 0.02]), shapes[:, ::-1])
    found = agreement(swapped, true)
    assert found.least_mac == pytest.approx(1.0)
    assert found.damping_pct == pytest.approx(0.0)
    assert found.frequency_pct == pytest.approx(100 * np.sqrt((0.02**2 + (0.005 / 1.01) ** 2) / 2))


def test_of_many_each_agrees_as_it_does_alone():
    """Among them one whose first mode is overdamped, and one that is not finite."""
    true = modes(Chain(3), _chain(0.01))
    springs = np.array([20.0, 30.0, np.nan, 2.0])
    many = {name: np.full(4, value) for name, value in _chain(0.01).items()} | {"k1": springs}
    many["c1"] = np.array([0.2, 0.4, 0.2, 40.0])
    found = agreement(modes_of_all(Chain(3), many), true)
    for i in range(4):
        alone = agreement(modes(Chain(3), {name: own[i] for name, own in many.items()}), true)
        for name, own in vars(found).items():
            assert float(own[i]) == pytest.approx(float(getattr(alone, name)), rel=1e-9)


def test_modes_too_far_apart_for_double_precision_agree_with_nothing() -> None:
    """A first mass of 1e-20 kg: its mode is 1e10 times faster, and rounds the other one's damping away."""
    system = Chain(2)
    true = dict(zip(system.names, (1.0, 1.0, 0.1, 0.1, 10.0, 10.0), strict=True))
    found = agreement(modes(system, {**true, "m1": 1e-20}), modes(system, true))
    assert found.frequency_pct == found.damping_pct == math.inf
    assert found.least_mac == 0.0
    assert agreement(modes(system, {**true, "m1": 1e-8}), modes(system, true)).damping_pct < math.inf
