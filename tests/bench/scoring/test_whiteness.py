"""The test of whiteness keeps its level, sees what it should, and is the textbook's sum."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from bench.scoring.whiteness import ljung_box


def test_it_is_the_sum_of_ljung_and_box() -> None:
    """Autocorrelations by ``numpy.correlate``, and the sum written out, for five lags of 25 samples."""
    e = np.random.default_rng(1).standard_normal(25)
    d = e - e.mean()
    r = np.correlate(d, d, "full")[25:30] / np.sum(d**2)
    q = 25 * 27 * (r[0] ** 2 / 24 + r[1] ** 2 / 23 + r[2] ** 2 / 22 + r[3] ** 2 / 21 + r[4] ** 2 / 20)
    np.testing.assert_allclose(ljung_box(e[None]), [chi2.sf(q, 5)], rtol=1e-12)


@pytest.mark.parametrize("n", [25, 200])
def test_white_noise_is_called_coloured_as_often_as_the_level_says(n: int) -> None:
    """5 % of 4,000 sets; the chi-square is an approximation, so between 3 and 8 %."""
    share = np.mean(ljung_box(np.random.default_rng(2).standard_normal((4000, n))) < 0.05)
    assert 0.03 < share < 0.08


def test_slow_residuals_are_seen_and_constant_ones_said_to_tell_nothing() -> None:
    slow = np.sin(np.linspace(0.0, 6.0, 60))[None] + 0.1 * np.random.default_rng(3).standard_normal((1, 60))
    assert ljung_box(slow)[0] < 1e-6
    assert np.isnan(ljung_box(np.ones((1, 60)))[0])
