"""Intervals, the steps within them and what Runge-Kutta's fourth order makes of them, against closed forms.

Compiled steps are those of numpy, whatever the numbers of sets and of steps are rounded up to.
"""

from __future__ import annotations

import numpy as np
import pytest

from bench import Force, Steps, interval_polynomials, rk4, rk4_path, rk4_scan, step_counts
from bench.dynamics.intervals import merged_grid
from bench.dynamics.stepper import compiled_path, padded
from bench.systems import SDOF, BoucWen, Duffing, System

FREE = {"m": 2.0, "c": 0.8, "k": 18.0}
RAMP = Force(np.array([0.0, 4.0]), np.array([0.0, 8.0]), "linear")
"""Two newtons a second."""


def response_to_the_ramp(t: np.ndarray) -> np.ndarray:
    """From rest: ``2 (t/k - c/k²)`` and the free vibration that cancels it at t = 0 (Inman, section 3.2)."""
    m, c, k = FREE.values()
    decay, wd = c / (2 * m), np.sqrt(k / m - (c / (2 * m)) ** 2)
    x0, v0 = c / k**2, -1 / k
    free = np.exp(-decay * t) * (x0 * np.cos(wd * t) + (v0 + decay * x0) / wd * np.sin(wd * t))
    return 2.0 * (t / k - c / k**2 + free)


def test_a_grid_holds_zero_the_times_and_the_samples_of_forces_before_the_last() -> None:
    force = Force(np.array([0.5, 1.0, 7.0]), np.ones(3))
    np.testing.assert_array_equal(merged_grid(np.array([1.0, 2.0]), [force]), [0.0, 0.5, 1.0, 2.0])


def test_the_polynomials_of_a_held_and_of_a_joined_up_force() -> None:
    """A held force is its sample until the next; a joined-up one goes straight to the next; both are zero outside."""
    times, values = np.array([1.0, 2.0, 4.0]), np.array([3.0, -1.0, 5.0])
    grid = np.array([0.0, 1.0, 2.0, 4.0, 5.0])
    held = interval_polynomials([Force(times, values, "zero_order")], grid, 1)
    np.testing.assert_allclose(held[..., 0], [[0.0, 3.0, -1.0, 0.0], [0.0] * 4], atol=1e-14)
    linear = interval_polynomials([Force(times, values, "linear", dof=1)], grid, 2)
    np.testing.assert_allclose(linear[..., 1], [[0.0, 3.0, -1.0, 0.0], [0.0, -4.0, 6.0, 0.0]], atol=1e-14)
    np.testing.assert_array_equal(linear[..., 0], 0.0)
    both = interval_polynomials([Force(times, values, "zero_order"), Force(times, values, "linear")], grid, 1)
    np.testing.assert_allclose(both[..., 0], [[0.0, 6.0, -2.0, 0.0], [0.0, -4.0, 6.0, 0.0]], atol=1e-14)


def test_the_polynomials_of_a_cubic_force_are_the_force() -> None:
    times = np.linspace(0.0, 3.0, 7)
    force = Force(times, np.sin(2.0 * times), "cubic")
    coefficients = interval_polynomials([force], times, 1)[..., 0]
    for part in (0.1, 0.37, 0.8):
        there = sum(c * part**i for i, c in enumerate(coefficients))
        np.testing.assert_allclose(there, force(times[:-1] + part * np.diff(times)), atol=1e-12)


def test_steps_are_equal_within_an_interval_none_longer_than_asked_and_end_where_the_intervals_do() -> None:
    grid = np.array([0.0, 0.5, 0.6, 2.0])
    counts = step_counts(grid, 0.2)
    np.testing.assert_array_equal(counts, [3, 1, 7])
    steps = Steps.over(grid, counts, [RAMP], 1)
    ends = np.concatenate([[0.0], np.cumsum(steps.lengths)])
    np.testing.assert_allclose(ends[steps.reached], grid)
    np.testing.assert_allclose(steps.lengths, np.repeat([0.5 / 3, 0.1, 0.2], [3, 1, 7]))
    middles = ends[:-1] + steps.lengths / 2
    np.testing.assert_allclose(steps.forces[..., 0], 2.0 * np.stack([ends[:-1], middles, ends[1:]], axis=1), atol=1e-14)


def test_half_the_step_leaves_a_sixteenth_of_the_error() -> None:
    grid = np.linspace(0.0, 4.0, 9)
    errors = []
    for longest in (0.1, 0.05):
        steps = Steps.over(grid, step_counts(grid, longest), [RAMP], 1)
        path = rk4_path(SDOF(), FREE, [np.array(0.0), np.array(0.0)], steps, np.arange(grid.size))
        errors.append(np.max(np.abs(path[0] - response_to_the_ramp(grid))))
    assert errors[0] < 1e-4
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.1)


def test_many_sets_at_the_wanted_points_alone() -> None:
    """Twice the mass, damper and spring move half as far."""
    grid = np.linspace(0.0, 4.0, 41)
    steps = Steps.over(grid, step_counts(grid, 0.02), [RAMP], 1)
    p = {name: value * np.array([1.0, 2.0]) for name, value in FREE.items()}
    wanted = np.array([0, 7, 40])
    x, _ = rk4_path(SDOF(), p, [np.zeros(2), np.zeros(2)], steps, wanted)
    exact = response_to_the_ramp(grid[wanted])
    np.testing.assert_allclose(x, [exact, exact / 2], atol=1e-7)


def test_jax_differentiates_the_path() -> None:
    """``x = cos(w t)`` with ``w² = k / m``: ``dx/dk = -t sin(w t) / (2 m w)``."""
    jax = pytest.importorskip("jax")
    jax.config.update("jax_enable_x64", True)
    grid = np.linspace(0.0, 3.0, 7)
    steps = Steps.over(grid, step_counts(grid, 0.01), [], 1)

    def displacement(k):
        start = jax.numpy.array([1.0, 0.0])
        return rk4_scan(SDOF(), {"m": 2.0, "c": 0.0, "k": k}, start, steps.lengths, steps.forces)[steps.reached, 0]

    np.testing.assert_allclose(displacement(18.0), np.cos(3.0 * grid), atol=2e-7)
    np.testing.assert_allclose(jax.jacfwd(displacement)(18.0), -grid * np.sin(3.0 * grid) / 12.0, atol=2e-7)


def test_a_step_of_any_components_is_the_taylor_polynomial_of_degree_four() -> None:
    """``s' = A s + b`` with constant b: the classical step is ``s + sum_(i<=4) (h A)^(i-1) h (A s + b) / i!``."""
    a, b, state, h = np.array([[0.0, 1.0], [-9.0, -0.4]]), np.array([0.0, 2.0]), np.array([1.0, -0.5]), 0.1
    whole = rk4(lambda s, push: [a @ s[0] + push], [state], h, (b, b, b))[0]
    first, second = rk4(lambda s, push: [s[1], -9.0 * s[0] - 0.4 * s[1] + push], [1.0, -0.5], h, (2.0, 2.0, 2.0))
    term, expected = h * (a @ state + b), state.copy()
    for i in range(1, 5):
        expected += term / i
        term = h * a @ term / i
    np.testing.assert_allclose(whole, expected, rtol=1e-14)
    np.testing.assert_allclose([first, second], expected, rtol=1e-14)


GRID, KNOTS = np.linspace(0.0, 2.0, 23), np.linspace(0.0, 2.0, 12)
STEPS = Steps.over(GRID, np.full(22, 5), [Force(KNOTS, 2.0 * np.cos(3.0 * KNOTS))], 1)
BOUC_WEN = {"m": 1.1, "c": 0.35, "k": 4.5, "kz": 7.0, "beta": 1.1, "gamma": 0.8}


@pytest.mark.parametrize("coarse", [False, True])
@pytest.mark.parametrize("shape", [(1,), (5,), (2, 3)])
@pytest.mark.parametrize(
    ("system", "p"), [(BoucWen(), BOUC_WEN), (Duffing(), {"m": 1.3, "c": 0.5, "k": 9.0, "k3": 7.0})], ids=["bw", "duff"]
)
def test_compiled_steps_are_numpys(system: System, p: dict[str, float], shape: tuple[int, ...], coarse: bool) -> None:
    pytest.importorskip("jax")
    rng = np.random.default_rng(2)
    sets = {name: value * np.exp(0.2 * rng.standard_normal(shape)) for name, value in p.items()}
    state = [np.full(shape, 0.9), np.full(shape, -0.2), *[np.zeros(shape)] * system.n_hidden]
    for wanted in (np.arange(23), np.array([0, 7, 22])):
        ours = compiled_path(system, sets, state, STEPS, wanted, coarse)
        theirs = rk4_path(system, sets, state, STEPS, wanted)
        assert ours.shape == theirs.shape
        np.testing.assert_allclose(ours, theirs, rtol=1e-11, atol=1e-12)


def test_a_set_that_diverges_is_not_finite_and_disturbs_no_other() -> None:
    pytest.importorskip("jax")
    p = {name: np.array([value, value]) for name, value in {"m": 1.0, "c": 0.4, "k": 8.0, "k3": 5.0}.items()}
    state = [np.array([0.9, 1e9]), np.zeros(2)]
    with np.errstate(all="ignore"):
        path, theirs = (carry(Duffing(), p, state, STEPS, np.arange(23)) for carry in (compiled_path, rk4_path))
    np.testing.assert_allclose(path[:, 0], theirs[:, 0], rtol=1e-11, atol=1e-12)
    assert not np.all(np.isfinite(path[:, 1]))


@pytest.mark.parametrize("number", [1, 2, 5, 7, 1000, 1024, 1025, 9999])
def test_at_most_a_fourth_more_steps_are_taken_or_the_next_power_of_four(number: int) -> None:
    steps = Steps(np.ones(number), np.ones((number, 3, 1)), np.arange(number + 1))
    for coarse in (False, True):
        lengths, forces = padded(steps, coarse)
        assert lengths.sum() == number
        assert len(forces) == lengths.size
        if coarse:
            assert np.emath.logn(4, lengths.size) == pytest.approx(np.ceil(np.emath.logn(4, number) - 1e-9))
        else:
            assert number <= lengths.size <= 1.25 * number
