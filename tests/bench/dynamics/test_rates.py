"""The fastest rate against eigenvalues that are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from bench import fastest_rates
from bench.systems import SDOF, BoucWen, Chain, Coulomb, Duffing, Pendulum

DUFFING = {"m": 2.0, "c": 1e-9, "k": 18.0, "k3": 4.0}


def test_a_vibrating_mass_turns_at_its_natural_frequency_and_two_decays_at_the_faster() -> None:
    """``λ² + c λ / m + k / m = 0``: a conjugate pair has modulus sqrt(k/m); m = 1, c = 5, k = 4 gives -1 and -4."""
    state = np.array([0.3, -2.0])
    np.testing.assert_allclose(fastest_rates(SDOF(), {"m": 2.0, "c": 0.8, "k": 50.0}, state), 5.0, rtol=1e-7)
    np.testing.assert_allclose(fastest_rates(SDOF(), {"m": 1.0, "c": 5.0, "k": 4.0}, state), 4.0, rtol=1e-7)


def test_of_two_equal_masses_the_faster_mode() -> None:
    """Squares of the modes of equal masses and springs: ``(3 ± sqrt 5) / 2 k / m``."""
    p = {"m1": 1.0, "m2": 1.0, "c1": 1e-12, "c2": 1e-12, "k1": 5.0, "k2": 5.0}
    np.testing.assert_allclose(fastest_rates(Chain(2), p, np.ones(4)), np.sqrt(2.5 * (3 + np.sqrt(5))), rtol=1e-7)


def test_a_hardening_spring_is_faster_where_it_is_stretched_a_pendulum_slower() -> None:
    """Slopes of the restoring force at x: ``k + 3 k3 x²``, and ``k cos(x / l)``."""
    at_rest, there = fastest_rates(Duffing(), DUFFING, np.array([0.5, 1.0]))
    assert at_rest == pytest.approx(3.0, rel=1e-7)
    assert there == pytest.approx(np.sqrt((18.0 + 3 * 4.0 * 0.25) / 2.0), rel=1e-7)
    at_rest, there = fastest_rates(Pendulum(), {"m": 2.0, "c": 1e-9, "k": 18.0, "l": 1.0}, np.array([1.0, 0.0]))
    assert at_rest == pytest.approx(3.0, rel=1e-7)
    assert there == pytest.approx(3.0 * np.sqrt(np.cos(1.0)), rel=1e-6)


def test_dry_friction_is_fast_at_rest_alone() -> None:
    """Below its smoothing velocity v_s it is viscous: ``λ² + mu / (m v_s) λ + k / m = 0`` with 50 and 9 per second."""
    at_rest, sliding = fastest_rates(Coulomb(), {"m": 2.0, "c": 1e-9, "k": 18.0, "mu": 1.0}, np.array([0.0, 1.0]))
    assert at_rest == pytest.approx(25.0 + np.sqrt(25.0**2 - 9.0), rel=1e-6)
    assert sliding == pytest.approx(3.0, rel=1e-6)


def test_hidden_states_move_too_and_may_be_left_out_where_they_are_zero() -> None:
    """Bouc and Wen's z follows x at small motion, so the stiffness is ``k + kz``."""
    p = {"m": 2.0, "c": 1e-9, "k": 8.0, "kz": 10.0, "beta": 0.5, "gamma": 0.5}
    full = fastest_rates(BoucWen(), p, np.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(full, 3.0, rtol=1e-5)
    np.testing.assert_array_equal(fastest_rates(BoucWen(), p, np.array([1.0, 0.0])), full)


def test_many_sets_at_once_and_one_that_ran_away() -> None:
    p = {**DUFFING, "k": np.array([18.0, np.inf, 32.0])}
    rates = fastest_rates(Duffing(), p, np.array([0.5, 1.0])[:, None])
    stretched = np.sqrt((np.array([18.0, np.nan, 32.0]) + 3.0) / 2.0)
    np.testing.assert_allclose(rates, [[3.0, np.nan, 4.0], stretched], rtol=1e-7)
    start = np.array([[0.5, 0.5, np.inf], [1.0, 1.0, 1.0]])
    np.testing.assert_allclose(fastest_rates(Duffing(), DUFFING, start)[1, :2], stretched[0], rtol=1e-7)
    assert np.isnan(fastest_rates(Duffing(), DUFFING, start)[1, 2])
