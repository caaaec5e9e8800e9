"""What our replicates say of a printed number, on samples whose quantiles are known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from bench.scoring.verdict import judge, mean_tails

SPREAD = np.linspace(0.01, 1.00, 100)
"""0.01, 0.02 … 1.00: five of 101 runs lie below 0.05, as many above 0.96; its mean is 0.505 ± 0.029, so another mean of
100 runs lies within 0.505 ± 1.66 · √2 · 0.029, 0.437 to 0.573, in 90 cases of 100."""
ORACLE = SPREAD / 4
"""Its 0.5 % quantile is 0.0025, that of its means near 0.126 - 2.58 · 0.0072 = 0.108."""


@pytest.mark.parametrize(
    ("paper", "single", "mean"),
    [
        (0.50, "reproduced", "reproduced"),
        (0.44, "reproduced", "reproduced"),
        (0.43, "reproduced", "ours worse"),
        (0.57, "reproduced", "reproduced"),
        (0.58, "reproduced", "ours better"),
        (0.20, "reproduced", "ours worse"),
        (0.80, "reproduced", "ours better"),
        (0.06, "reproduced", "ours worse"),
        (0.04, "ours worse", "ours worse"),
        (0.97, "ours better", "ours better"),
    ],
)
def test_a_number_is_placed_as_a_single_run_and_as_a_mean(paper: float, single: str, mean: str) -> None:
    verdict = judge(paper, SPREAD, ORACLE, 0.0)
    assert (verdict.single, verdict.mean) == (single, mean)
    assert verdict.text == (single if single == mean else f"{single} (single run), {mean} (mean)")


@pytest.mark.parametrize(
    ("paper", "prior_share", "text"),
    [
        (0.002, 0.0, "incompatible"),
        (0.05, 0.0, "reproduced (single run), ours worse (mean)"),
        (0.002, 0.97, "not decidable (97 % prior)"),
        (0.5, 0.49, "reproduced"),
    ],
)
def test_the_oracle_and_the_prior_can_decide(paper: float, prior_share: float, text: str) -> None:
    """A number of 0.05 lies below the oracle's mean, but one efficient run in many lies there."""
    assert judge(paper, SPREAD, ORACLE, prior_share).text == text


def test_failures_are_infinite_errors() -> None:
    """A tenth failed: the 95 % quantile is infinite, and so is nearly every mean."""
    ours = np.where(np.arange(100) < 90, SPREAD, math.inf)
    verdict = judge(5.0, ours, ORACLE, 0.0)
    assert (verdict.single, verdict.mean) == ("reproduced", "ours worse")


@pytest.mark.parametrize("n", [20, 100])
def test_verdicts_keep_their_level_where_nothing_differs(n: int) -> None:
    """Numbers from the same law as ours: outside in a tenth of the cases, p below 5 % in one of twenty.

    Without the luck of the other mean it would be a quarter, and one of six. A thousand cases: ±3 %, three standard
    errors. Ranks of 21 runs are coarse: two of them are outside.
    """
    rng, times = np.random.default_rng(3), 1000
    outside_mean = outside_single = small = 0
    for _ in range(times):
        ours = np.abs(rng.standard_normal(n))
        other = np.abs(rng.standard_normal(n))
        outside_mean += judge(other.mean(), ours, ours, 0.0).mean != "reproduced"
        outside_single += judge(other[0], ours, ours, 0.0).single != "reproduced"
        small += 2.0 * min(mean_tails(other.mean(), ours)) < 0.05
    assert outside_mean / times == pytest.approx(0.10, abs=0.03)
    assert outside_single / times == pytest.approx(0.10, abs=0.03)
    assert small / times == pytest.approx(0.05, abs=0.021)


def test_the_p_value_is_that_of_two_samples_of_one_spread() -> None:
    """The t-test of two samples with the same standard deviation, but for its degrees of freedom."""
    other = SPREAD + 0.05
    found = 2.0 * min(mean_tails(float(other.mean()), SPREAD))
    t = stats.ttest_ind(SPREAD, other).statistic
    assert found == pytest.approx(2.0 * stats.t.sf(abs(t), 99))


def test_a_failure_among_ours_makes_other_means_fail_too() -> None:
    """One of 50 failed: the chance that a resample of a resample has no failure, by drawing them."""
    rng = np.random.default_rng(4)
    ours = np.r_[np.linspace(0.0, 1.0, 49), math.inf]
    first, places = rng.integers(0, 50, (2, 4000, 50))
    spared = float(np.mean(np.all(np.take_along_axis(first, places, 1) != 49, axis=1)))
    below, above = mean_tails(1e6, ours)  # far above every finite mean
    assert below == pytest.approx(spared, abs=0.03)  # four standard errors
    assert below + above == pytest.approx(1.0)
