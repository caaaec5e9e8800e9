"""Medians of resamples; the test of whiteness keeps its level behind a fit, and rests on the textbook's sum."""

from __future__ import annotations

import numpy as np
import pytest

from bench.scoring.statistics import RESAMPLES, counts, ljung_box, medians, whiteness


@pytest.mark.parametrize("n", [1, 2, 9, 40, 301])
def test_medians_of_resamples_are_numpys(n: int) -> None:
    """A quarter of the values are failures."""
    values, drawn = np.random.default_rng(n).standard_normal(n), np.random.default_rng(0).integers(0, n, (RESAMPLES, n))
    values[: n // 4] = np.inf
    with np.errstate(invalid="ignore"):
        expected = np.median(values[drawn], axis=1)
    np.testing.assert_array_equal(medians(values, counts(n)), expected)


def test_it_is_the_sum_of_ljung_and_box() -> None:
    """Autocorrelations by ``numpy.correlate``, and the sum written out, for five lags of 25 samples."""
    e = np.random.default_rng(1).standard_normal(25)
    d = e - e.mean()
    r = np.correlate(d, d, "full")[25:30] / np.sum(d**2)
    q = 25 * 27 * (r[0] ** 2 / 24 + r[1] ** 2 / 23 + r[2] ** 2 / 22 + r[3] ** 2 / 21 + r[4] ** 2 / 20)
    np.testing.assert_allclose(ljung_box(e[None]), [q], rtol=1e-12)


@pytest.mark.parametrize("n", [12, 25, 200])
def test_residuals_of_a_right_fit_are_called_coloured_as_often_as_the_level_says(n: int) -> None:
    """Least squares on four damped waves, 4,000 sets: 5 %, the 999 draws of the null and these sets allowed for."""
    t = np.linspace(0.0, 10.0, n)
    columns = np.exp(-0.2 * t)[:, None] * np.stack(
        [np.cos(2.8 * t), np.sin(2.8 * t), t * np.cos(2.8 * t), t * np.sin(2.8 * t)], 1
    )
    noise = np.random.default_rng(2).standard_normal((4000, n))
    left = noise - noise @ np.linalg.pinv(columns).T @ columns.T
    assert 0.03 < np.mean(whiteness(left, columns) < 0.05) < 0.07


def test_slow_residuals_are_seen_and_constant_ones_said_to_tell_nothing() -> None:
    t = np.linspace(0.0, 6.0, 60)
    slow = np.sin(t)[None] + 0.1 * np.random.default_rng(3).standard_normal((1, 60))
    assert whiteness(slow, np.ones((60, 1)))[0] <= 0.001
    assert np.isnan(whiteness(np.ones((1, 60)), np.ones((60, 1)))[0])
