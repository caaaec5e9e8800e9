"""The share of bias in a mean square error, against its definition."""

from __future__ import annotations

import numpy as np
import pytest

from bench.scoring.statistics import bias_share


def test_a_constant_error_is_all_bias_and_a_symmetric_one_none() -> None:
    assert bias_share(np.full(5, 1.1)) == pytest.approx(1.0)
    assert bias_share(1 + 0.1 * np.array([-1.0, 1.0, -1.0, 1.0])) == 0.0


def test_it_is_bias_squared_over_bias_squared_and_variance() -> None:
    """Errors of mean 0.3 and standard deviation 0.4: 0.09 of 0.25."""
    errors = 0.3 + 0.4 * np.random.default_rng(1).standard_normal(200_000)
    assert bias_share(1 + errors) == pytest.approx(0.36, abs=0.01)


def test_chance_alone_is_not_taken_for_bias() -> None:
    """Over many samples of 20 unbiased errors the share that is not cut off at nothing would be 0 on average.

    Cut off, the mean of the positive part of (chi-square of one degree of freedom less 1) over 20 is about 0.024.
    """
    rng = np.random.default_rng(2)
    shares = [bias_share(1 + 0.1 * rng.standard_normal(20)) for _ in range(2000)]
    assert np.mean(shares) < 0.03
    assert np.median(shares) == 0.0
