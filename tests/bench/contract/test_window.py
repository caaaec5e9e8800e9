"""The arrival cost of a window, against closed forms."""

import numpy as np
import pytest

from bench import Normal
from bench.contract.window import product


def own(mean, sd) -> Normal:
    return Normal(("a",), np.array([mean]), np.array([[sd**2]]), log=True)


def test_two_beliefs_that_agree_join_by_their_precisions() -> None:
    found = product(own(0.02, 0.1), np.array([0.0]), np.array([[0.05**2]]))
    weights = np.array([1 / 0.1**2, 1 / 0.05**2])
    assert found.mean[0] == pytest.approx(0.02 * weights[0] / weights.sum())
    assert found.covariance[0, 0] == pytest.approx(1 / weights.sum())


def test_a_belief_that_no_longer_holds_hardly_counts() -> None:
    found = product(own(2.0, 0.1), np.array([0.0]), np.array([[0.05**2]]))
    assert found.mean[0] == pytest.approx(2.0, abs=0.01)
    assert np.sqrt(found.covariance[0, 0]) == pytest.approx(0.1, rel=0.01)
