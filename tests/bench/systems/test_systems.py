"""Mass matrix, acceleration and regression columns follow from the residual of a system."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from more_systems import BoucWen, Coupled

from bench import InputError, Ops, acceleration, array_ops, mass_matrix, numpy_ops, regression_columns, state_rate
from bench.dynamics.mechanics import linear_matrices
from bench.systems import SDOF, Chain, Duffing, System, make_system

SYSTEMS = [SDOF(), Chain(2), Chain(3), Duffing()]
IDS = ["sdof", "chain2", "chain3", "duffing"]


def by_hand(system: System, p: Mapping[str, float], x: Any, v: Any, a: Any, f: Any) -> list[Any]:
    """The equations of motion, written out for each system from its free-body diagram."""
    if isinstance(system, SDOF):
        return [p["m"] * a[0] + p["c"] * v[0] + p["k"] * x[0] - f[0]]
    if isinstance(system, Duffing):
        return [p["m"] * a[0] + p["c"] * v[0] + p["k"] * x[0] + p["k3"] * x[0] ** 3 - f[0]]
    if system.n_dof == 2:
        pull = p["c2"] * (v[1] - v[0]) + p["k2"] * (x[1] - x[0])
        return [p["m1"] * a[0] + p["c1"] * v[0] + p["k1"] * x[0] - pull - f[0], p["m2"] * a[1] + pull - f[1]]
    pull2 = p["c2"] * (v[1] - v[0]) + p["k2"] * (x[1] - x[0])
    pull3 = p["c3"] * (v[2] - v[1]) + p["k3"] * (x[2] - x[1])
    return [
        p["m1"] * a[0] + p["c1"] * v[0] + p["k1"] * x[0] - pull2 - f[0],
        p["m2"] * a[1] + pull2 - pull3 - f[1],
        p["m3"] * a[2] + pull3 - f[2],
    ]


def drawn(system: System, n: int = 5) -> tuple[dict[str, float], list[list[np.ndarray]]]:
    """Random parameters, and x, v, a, f as one array of shape (n,) a DOF."""
    rng = np.random.default_rng(7)
    p = {name: float(rng.uniform(0.5, 2.0)) for name in system.names}
    return p, [[rng.standard_normal(n) for _ in range(system.n_dof)] for _ in range(4)]


@pytest.mark.parametrize("system", SYSTEMS, ids=IDS)
def test_regression_columns_times_parameters_plus_offset_is_the_residual(system: System) -> None:
    p, (x, v, a, f) = drawn(system)
    columns, offset = regression_columns(system, x, v, a, f)
    assert columns.shape == (5 * system.n_dof, len(system.names))
    expected = np.concatenate(by_hand(system, p, x, v, a, f))
    np.testing.assert_allclose(columns @ np.array(list(p.values())) + offset, expected, atol=1e-12)
    np.testing.assert_allclose(offset, -np.concatenate(f), atol=1e-12)


@pytest.mark.parametrize("system", SYSTEMS, ids=IDS)
def test_the_mass_matrix_is_diagonal_with_the_masses(system: System) -> None:
    p, (x, v, _, f) = drawn(system, 1)
    matrix, rest = mass_matrix(system, p, x, v, f, [], numpy_ops)
    masses = [p[parameter.name] for parameter in system.parameters if parameter.kind == "mass"]
    np.testing.assert_allclose(np.squeeze(np.array(matrix, float)), np.squeeze(np.diag(masses)), atol=1e-12)
    zero = [np.zeros(1)] * system.n_dof
    np.testing.assert_allclose(rest, by_hand(system, p, x, v, zero, f), atol=1e-12)


def test_a_coupled_mass_matrix_and_the_acceleration_that_it_gives() -> None:
    """Cramer's rule by hand on ``[[m1 + m2, m2 cos x2], [m2 cos x2, m2]] a = [f1 - k x1, f2 - k sin x2]``."""
    p, (x, v, _, f) = drawn(Coupled(), 4)
    m, tie = p["m1"] + p["m2"], p["m2"] * np.cos(x[1])
    right = f[0] - p["k"] * x[0], f[1] - p["k"] * np.sin(x[1])
    determinant = m * p["m2"] - tie**2
    expected = [
        (p["m2"] * right[0] - tie * right[1]) / determinant,
        (m * right[1] - tie * right[0]) / determinant,
    ]
    matrix, _ = mass_matrix(Coupled(), p, x, v, f, [], numpy_ops)
    np.testing.assert_allclose(matrix[0][1], tie)
    np.testing.assert_allclose(matrix[1][0], 2 * tie)
    np.testing.assert_allclose(acceleration(Coupled(), p, x, v, f, [], numpy_ops), expected, rtol=1e-12)


@pytest.mark.parametrize("system", SYSTEMS, ids=IDS)
def test_the_acceleration_makes_the_residual_vanish_and_the_state_rate_carries_it(system: System) -> None:
    p, (x, v, _, f) = drawn(system)
    a = acceleration(system, p, x, v, f, [], numpy_ops)
    np.testing.assert_allclose(by_hand(system, p, x, v, a, f), 0.0, atol=1e-12)
    rate = state_rate(system, p, [*x, *v], f, numpy_ops)
    np.testing.assert_allclose(np.array(rate), np.array([*v, *a]), atol=1e-12)


def test_the_acceleration_of_the_duffing_oscillator_by_hand() -> None:
    p = {"m": 2.0, "c": 0.5, "k": 3.0, "k3": 4.0}
    a = acceleration(Duffing(), p, [0.5], [-1.0], [1.0], [], numpy_ops)
    assert a[0] == pytest.approx((1.0 + 0.5 * 1.0 - 3.0 * 0.5 - 4.0 * 0.125) / 2.0)


def test_the_acceleration_of_a_chain_in_jax_is_numpys() -> None:
    jax = pytest.importorskip("jax")
    jax.config.update("jax_enable_x64", True)
    p, (x, v, _, f) = drawn(Chain(3), 1)
    x, v, f = ([c[0] for c in part] for part in (x, v, f))
    theirs = jax.jit(lambda *args: acceleration(Chain(3), *args, [], array_ops(jax.numpy)))(p, x, v, f)
    a = np.array(theirs)
    np.testing.assert_allclose(by_hand(Chain(3), p, x, v, a, f), 0.0, atol=1e-12)


def test_the_matrices_of_a_chain_are_the_textbooks() -> None:
    """Tridiagonal: the sum of both links on the diagonal, minus the shared link beside it (Inman, section 4.1)."""
    p = {"m1": 1.0, "m2": 2.0, "m3": 3.0, "c1": 0.1, "c2": 0.2, "c3": 0.3, "k1": 10.0, "k2": 20.0, "k3": 30.0}
    mass, damping, stiffness = linear_matrices(Chain(3), p)
    np.testing.assert_allclose(mass, np.diag([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(stiffness, [[30.0, -20.0, 0.0], [-20.0, 50.0, -30.0], [0.0, -30.0, 30.0]])
    np.testing.assert_allclose(damping, np.array([[0.3, -0.2, 0.0], [-0.2, 0.5, -0.3], [0.0, -0.3, 0.3]]), atol=1e-15)


def test_quantities_are_the_textbook_formulas() -> None:
    p = {"m": 2.0, "c": 0.6, "k": 18.0}
    values = {q.name: q.value(p) for q in SDOF().quantities}
    assert values["k_over_m"] == pytest.approx(9.0)
    assert values["c_over_m"] == pytest.approx(0.3)
    assert values["natural_frequency"] == pytest.approx(3.0 / (2 * np.pi))
    assert values["damping_ratio"] == pytest.approx(0.6 / (2 * np.sqrt(36.0)))


def test_hidden_states_have_their_own_rates_in_the_state_rate() -> None:
    rate = state_rate(BoucWen(), {"m": 2.0, "c": 0.5, "k": 3.0}, [0.1, -2.0, 0.4], [1.0], numpy_ops)
    assert rate == pytest.approx([-2.0, (1.0 + 0.5 * 2.0 - 3.0 * 0.4) / 2.0, -2.0 - 0.5 * 2.0 * 0.4])


def test_a_residual_with_its_own_ops_runs_where_numpy_does_not() -> None:
    """The ops of the library at hand are used, never numpy's: here they only write down what was called."""
    calls: list[str] = []
    ops = cast(Ops, SimpleNamespace(cos=lambda x: calls.append("cos") or 1.0, sin=lambda x: calls.append("sin") or 0.0))
    Coupled().residual({"m1": 1.0, "m2": 1.0, "k": 1.0}, [0, 0], [0, 0], [0, 0], [0, 0], [], ops)
    assert calls == ["cos", "sin"]


@pytest.mark.parametrize(
    ("name", "options", "part"),
    [("beam", {}, "chain, coulomb, duffing"), ("chain", {"masses": 3}, "masses"), ("chain", {"n": 0}, "one mass")],
)
def test_an_unknown_system_or_option_is_refused_with_its_name(name: str, options: dict[str, int], part: str) -> None:
    with pytest.raises(InputError, match=part):
        make_system(name, options)
