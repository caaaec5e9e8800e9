"""Intervals, the steps within them and what Runge-Kutta's fourth order makes of them, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from bench import Force, Steps, interval_polynomials, rk4_path, rk4_scan, step_counts
from bench.dynamics.intervals import merged_grid
from bench.systems import SDOF

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

    def displacement(k):  # type: ignore[no-untyped-def]
        start = jax.numpy.array([1.0, 0.0])
        return rk4_scan(SDOF(), {"m": 2.0, "c": 0.0, "k": k}, start, steps.lengths, steps.forces)[steps.reached, 0]

    np.testing.assert_allclose(displacement(18.0), np.cos(3.0 * grid), atol=2e-7)
    np.testing.assert_allclose(jax.jacfwd(displacement)(18.0), -grid * np.sin(3.0 * grid) / 12.0, atol=2e-7)
