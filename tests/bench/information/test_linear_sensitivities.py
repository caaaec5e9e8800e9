"""Derivatives of linear responses, against closed forms in fifty digits and against jax through Runge-Kutta steps."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
import pytest

from bench.contract.problem import Force, InitialState
from bench.dynamics.linear_motion import linear_motion
from bench.information.sensitivities import linear_sensitivities, stepped_sensitivities
from bench.systems import Chain, LoadedSystem, Matrices, RayleighChain, System
from bench.systems.linear import SDOF

mp = pytest.importorskip("mpmath").mp.clone()
mp.dps = 50

Response = Callable[[Mapping[str, Any], Sequence[Any], Any], Any]
"""Displacement of the last DOF at given parameters, initial state and time."""


def one_of_two(
    system: System, p: Mapping[str, float], start: InitialState, times: np.ndarray, forces: Sequence[Force] = ()
) -> tuple[np.ndarray, np.ndarray]:
    """:func:`linear_motion` in the form of :func:`linear_sensitivities`, in the company of other parameters."""
    n = system.n_dof
    own = np.concatenate([start.displacement, start.velocity])
    sets = {name: np.array([1.3 * value, value]) for name, value in p.items()}
    path, slopes = linear_motion(system, sets, np.stack([2.0 * own, own]), times, forces)
    return path[1, :, :n].T, np.moveaxis(slopes[1, :, :n], 1, 0)


def check(
    system: System,
    p: Mapping[str, float],
    state: Sequence[float],
    times: np.ndarray,
    oracle: Response,
    forces: Sequence[Force] = (),
    every: int = 1,
) -> None:
    """Compare with central differences of an oracle in fifty digits, in the last DOF at one time of ``every``."""
    n = system.n_dof
    start = InitialState(np.array(state[:n]), np.array(state[n:]))
    response, slopes = linear_sensitivities(system, p, start, times, forces)
    assert slopes.shape == (n, times.size, len(p) + 2 * n)
    again, others = one_of_two(system, p, start, times, forces)
    np.testing.assert_allclose(again, response, atol=1e-11 * np.max(np.abs(response)))
    np.testing.assert_allclose(others, slopes, atol=1e-11 * np.max(np.abs(slopes), axis=(0, 1)).max())
    exact, h = {name: mp.mpf(value) for name, value in p.items()}, mp.mpf(10) ** -15
    at = times[::every]
    found = [float(oracle(exact, state, mp.mpf(t))) for t in at]
    np.testing.assert_allclose(response[-1, ::every], found, atol=1e-11 * np.max(np.abs(found)))
    for i in range(len(p) + 2 * n):

        def moved(t: float, sign: int, i: int = i) -> Any:
            q, s = dict(exact), [mp.mpf(value) for value in state]
            if i < len(p):
                q[system.names[i]] *= mp.exp(sign * h)
            else:
                s[i - len(p)] += sign * h
            return oracle(q, s, mp.mpf(t))

        expected = [float((moved(t, 1) - moved(t, -1)) / (2 * h)) for t in at]
        np.testing.assert_allclose(
            slopes[-1, ::every, i], expected, atol=1e-11 * np.max(np.abs(expected)), err_msg=str(i)
        )


def free_sdof(p: Mapping[str, Any], state: Sequence[Any], t: Any) -> Any:
    """``e^(-at) (x0 cos wt + (v0 + a x0) sin(wt)/w)`` with ``a = c/2m``, ``w² = k/m - a²`` of either sign."""
    a = p["c"] / (2 * p["m"])
    w = mp.sqrt(mp.mpc(p["k"] / p["m"] - a * a))
    sine = mp.sin(w * t) / w if w else t
    return mp.re(mp.exp(-a * t) * (state[0] * mp.cos(w * t) + (state[1] + a * state[0]) * sine))


@pytest.mark.parametrize(
    ("c", "duration"),
    [(0.4, 20.0), (0.002 * 8**0.5, 1111.0), (2 * 8**0.5, 10.0), (2.0 * 1.5, 10.0), (300.0, 10.0)],
    ids=["reference", "500 cycles at 0.1 %", "critical", "overdamped", "two rates 10,000 apart"],
)
def test_free_vibration_of_one_mass(c: float, duration: float) -> None:
    times = np.unique(np.concatenate([np.linspace(0, duration, 25), np.linspace(0, duration, 400)]))
    p = {"m": 1.0, "c": c, "k": 2.0 if c == 3.0 else 8.0}
    check(SDOF(), p, [1.0, -0.5], times, free_sdof, every=11)


def test_the_order_in_which_parameters_are_given_does_not_matter() -> None:
    start, times = InitialState(np.array([1.0]), np.array([0.0])), np.linspace(0, 5, 7)
    one = linear_sensitivities(SDOF(), {"m": 1.0, "c": 0.4, "k": 8.0}, start, times)[1]
    other = linear_sensitivities(SDOF(), {"k": 8.0, "c": 0.4, "m": 1.0}, start, times)[1]
    np.testing.assert_array_equal(one, other)


def test_the_start_alone() -> None:
    start = InitialState(np.array([2.0]), np.array([3.0]))
    response, slopes = linear_sensitivities(SDOF(), {"m": 1.0, "c": 0.4, "k": 8.0}, start, np.array([0.0]))
    np.testing.assert_array_equal(response, [[2.0]])
    np.testing.assert_array_equal(slopes, [[[0.0, 0.0, 0.0, 1.0, 0.0]]])


CUBIC = (0.7, -1.1, 0.4, 0.05)
"""Coefficients of a force (N) in powers of time; a cubic spline through four samples of it is the force itself."""


def forced(matrices: Callable[[Mapping[str, Any]], tuple[Any, Any, Any]]) -> Response:
    """The last of two DOFs, the force on the first, by one exponential of mass, damping, stiffness written out."""

    def response(p: Mapping[str, Any], state: Sequence[Any], t: Any) -> Any:
        m, c, k = map(mp.matrix, matrices(p))
        inverse, both = mp.inverse(m), mp.zeros(8)
        for i in range(2):
            both[i, 2 + i] = both[4 + i, 5 + i] = 1
            both[2 + i, 4] = inverse[i, 0]
            for j in range(2):
                both[2 + i, j], both[2 + i, 2 + j] = -(inverse * k)[i, j], -(inverse * c)[i, j]
        both[6, 7] = 1
        force = [mp.factorial(j) * mp.mpf(value) for j, value in enumerate(CUBIC)]
        return (mp.expm(both * t, method="taylor") * mp.matrix([*state, *force]))[1]

    return response


def rayleigh(p: Mapping[str, Any]) -> tuple[Any, Any, Any]:
    m = [[p["m1"], 0], [0, p["m2"]]]
    k = [[p["k1"] + p["k2"], -p["k2"]], [-p["k2"], p["k2"]]]
    return m, [[p["alpha"] * m[i][j] + p["beta"] * k[i][j] for j in range(2)] for i in range(2)], k


def coupled(p: Mapping[str, Any]) -> tuple[Any, Any, Any]:
    """Two equal masses on equal springs that only a damper of matrix ``c12`` ties: the frequencies are the same."""
    return [[p["m11"], 0], [0, p["m22"]]], [[p["c11"], p["c12"]], [p["c12"], 0]], [[p["k11"], 0], [0, p["k22"]]]


@pytest.mark.parametrize(
    ("system", "p", "matrices"),
    [
        (RayleighChain(2), {"m1": 1.0, "m2": 0.8, "k1": 12.0, "k2": 9.0, "alpha": 0.1, "beta": 0.02}, rayleigh),
        (
            Matrices(((1, 1, 1), (2, 2, 1)), ((1, 1, 1), (1, 2, 1)), ((1, 1, 1), (2, 2, 1))),
            {"m11": 1.0, "m22": 1.0, "c11": 0.2, "c12": 0.1, "k11": 9.0, "k22": 9.0},
            coupled,
        ),
    ],
    ids=["not affine in the parameters", "equal frequencies"],
)
def test_two_masses_under_a_cubic_force(
    system: System, p: Mapping[str, float], matrices: Callable[[Mapping[str, Any]], tuple[Any, Any, Any]]
) -> None:
    at = np.linspace(0.0, 4.0, 4)
    force = Force(at, np.polynomial.polynomial.polyval(at, CUBIC), "cubic", 0)
    times = np.array([0.0, 0.3, 0.35, 1.7, 3.9, 4.0])
    check(system, p, [0.1, -0.2, 0.0, 0.5], times, forced(matrices), [force], every=3)


class BentSign(SDOF):
    """The stiffness through a function that is not analytic: a modulus."""

    name: ClassVar[str] = "bent_sign"

    def residual(self, p, x, v, a, f, z, ops):
        return [p["m"] * a[0] + p["c"] * v[0] + ops.abs(-p["k"]) * x[0] - f[0]]


def test_a_modulus_of_a_parameter_has_its_derivative() -> None:
    check(BentSign(), {"m": 1.0, "c": 0.4, "k": 8.0}, [1.0, 0.0], np.linspace(0, 5, 5), free_sdof)


CHAIN = {"m1": 1.0, "m2": 0.8, "c1": 0.2, "c2": 0.15, "k1": 12.0, "k2": 9.0}


@pytest.mark.parametrize(
    ("system", "p", "hold"),
    [
        (SDOF(), {"m": 1.0, "c": 0.4, "k": 8.0}, "zero_order"),
        (LoadedSystem(Chain(2), (0.0, 0.3)), CHAIN, "linear"),
        (RayleighChain(2), {"m1": 1.0, "m2": 0.8, "k1": 12.0, "k2": 9.0, "alpha": 0.1, "beta": 0.02}, "cubic"),
    ],
    ids=["held", "added mass, linear", "not affine, cubic"],
)
def test_jax_through_runge_kutta_steps_finds_the_same(system: System, p: Mapping[str, float], hold: Any) -> None:
    """Fourth order at 240 steps a radian, over the record and after the force has ended."""
    rng, n = np.random.default_rng(5), system.n_dof
    start = InitialState(rng.standard_normal(n), rng.standard_normal(n))
    force = Force(np.linspace(0.0, 3.0, 9), rng.standard_normal(9), hold, n - 1)
    times = np.linspace(0.0, 4.0, 23)
    exact, stepped = (f(system, p, start, times, [force]) for f in (linear_sensitivities, stepped_sensitivities))
    for ours, theirs in zip(exact, stepped, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-9 * np.max(np.abs(theirs)))
