"""Recursive least squares against padasip, against batch least squares, and its trajectory."""

from __future__ import annotations

import numpy as np
import pytest

from bench import Units
from bench.scenario.scenario import Scenario
from methods.regression.ls import LS
from methods.regression.rls import RLS, recursive_least_squares

PLANT = {"m": 1.3, "c": 0.6, "k": 9.0}  # a plant that is in no table
SCENARIO = Scenario("sdof", PLANT, ((0.8,), (0.5,)), 20.0)


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


@pytest.mark.parametrize("forgetting", [1.0, 0.98, 0.9])
def test_it_is_the_filter_of_padasip(forgetting: float) -> None:
    filters = pytest.importorskip("padasip.filters")
    draw = np.random.default_rng(4)
    columns, target = draw.standard_normal((2, 40, 3)), draw.standard_normal((2, 40))
    path = recursive_least_squares(columns, target, forgetting, diffuse=100.0)
    for i in range(2):
        oracle = filters.FilterRLS(n=3, mu=forgetting, eps=0.01, w="zeros")
        for j in range(40):
            oracle.adapt(target[i, j], columns[i, j])
            np.testing.assert_allclose(path[j, i], oracle.w, rtol=1e-10, atol=1e-10)


def test_without_forgetting_it_ends_at_batch_least_squares() -> None:
    for problem, _ in SCENARIO.replicates(3, 4):
        batch, recursive = LS().identify(problem, rng()).groups, RLS(forgetting=1.0).identify(problem, rng()).groups
        np.testing.assert_allclose(recursive.mean, batch.mean, rtol=1e-6)
        np.testing.assert_allclose(recursive.covariance, batch.covariance, rtol=1e-4)


def test_rows_of_one_sample_forget_once() -> None:
    """Two rows a sample: weighted least squares with one power of the factor a sample."""
    draw = np.random.default_rng(7)
    columns, target = draw.standard_normal((1, 30, 2)), draw.standard_normal((1, 30))
    path = recursive_least_squares(columns, target, 0.9, diffuse=1e9, rows_per_sample=2)
    assert path.shape == (15, 1, 2)
    weights = np.sqrt(0.9 ** np.repeat(np.arange(14, -1, -1), 2))
    weighted, *_ = np.linalg.lstsq(columns[0] * weights[:, None], target[0] * weights, rcond=None)
    np.testing.assert_allclose(path[-1, 0], weighted, rtol=1e-5)


def test_its_rounding_does_not_grow_with_the_diffuse_start() -> None:
    """Weighted least squares on the rows and those of the start, columns alike to 0.1 %: to 1e-10 of the solution."""
    draw, diffuse = np.random.default_rng(8), 1e6
    columns = draw.standard_normal((1, 40, 1)) + 0.001 * draw.standard_normal((1, 40, 3))
    target = draw.standard_normal((1, 40))
    weights = np.sqrt(0.98 ** np.arange(39, -1, -1))
    rows = np.concatenate([columns[0] * weights[:, None], np.sqrt(0.98**40 / diffuse) * np.eye(3)])
    expected, *_ = np.linalg.lstsq(rows, np.append(target[0] * weights, np.zeros(3)), rcond=None)
    computed = recursive_least_squares(columns, target, 0.98, diffuse)[-1, 0]
    np.testing.assert_allclose(computed, expected, rtol=1e-10)


def test_the_trajectory_is_kept_in_the_units_of_the_problem() -> None:
    problem, _ = SCENARIO.replicates(3, 1)[0]
    estimate = RLS().identify(problem, rng())
    trajectory, times = estimate.traces["trajectory"], estimate.traces["trajectory_times"]
    assert trajectory.shape == (23, 2)
    np.testing.assert_allclose(trajectory[-1], estimate.groups.mean, rtol=1e-12)
    np.testing.assert_allclose(times, SCENARIO.times[1:-1])
    faster = RLS().identify(problem.expressed_in(Units(time=0.1)), rng())
    np.testing.assert_allclose(faster.traces["trajectory"], trajectory * [0.01, 0.1], rtol=1e-6)
