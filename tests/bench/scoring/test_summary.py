"""From replicates to one line a metric: failures count, the excess is over the successful, intervals cover."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from bench import Status
from bench.information.fisher import Bound
from bench.scoring.row import Row
from bench.scoring.summary import summarise

BOUND = Bound(("m",), {"m": 0.02, "k": math.inf}, {"m": True, "k": False}, {"m": 0.0, "k": 0.0}, 0.5, 0.25, ())


def ok(i: int, **scores: float) -> Row:
    return Row(i, Status.OK, scores={"rmse": 1.0, "rmse_simulated": 1.0, "rmse_forecast": 1.0, **scores})


def failed(i: int) -> Row:
    return Row(i, Status.DIVERGED, "it did")


def test_mean_median_and_excess_by_hand() -> None:
    """Root mean square of 1, 2, 2, 4 is 2.5; the bound is 2 %, so the excess is 1.25."""
    rows = [ok(i, m_error_pct=value) for i, value in enumerate([1.0, 4.0, 2.0, 2.0])]
    s = summarise(rows, BOUND)["m_error_pct"]
    assert (s["mean"], s["median"], s["bound"], s["n_ok"]) == (2.25, 2.0, pytest.approx(2.0), 4)
    assert s["excess"] == pytest.approx(2.5 / 2.0)
    assert 1.0 <= s["ci_low"] <= 2.0 <= s["ci_high"] <= 4.0


def test_bounds_of_the_displacement_metrics() -> None:
    summary = summarise([ok(0, rmse_forecast=0.5), ok(1, rmse_forecast=0.5)], BOUND)
    assert (summary["rmse"]["bound"], summary["rmse_simulated"]["bound"], summary["rmse_forecast"]["bound"]) == (
        0.5,
        0.5,
        0.25,
    )
    assert summary["rmse"]["excess"] == pytest.approx(2.0)
    assert summary["rmse_forecast"]["excess"] == pytest.approx(2.0)


def test_a_failure_counts_as_infinite_in_mean_and_median_but_not_in_the_excess() -> None:
    rows = [ok(0, m_error_pct=3.0), ok(1, m_error_pct=4.0), failed(2)]
    s = summarise(rows, BOUND)["m_error_pct"]
    assert (s["mean"], s["median"], s["ci_high"], s["n_ok"]) == (math.inf, 4.0, math.inf, 2)
    assert s["excess"] == pytest.approx(math.sqrt(12.5) / 2.0)


def test_a_replicate_without_a_score_that_others_have_counts_as_failed_in_it() -> None:
    """A negative group has no frequency: the replicate is no better for lacking the score."""
    s = summarise([ok(0, m_error_pct=3.0), ok(1), ok(2, m_error_pct=1.0)], BOUND)["m_error_pct"]
    assert (s["median"], s["mean"], s["n_ok"]) == (3.0, math.inf, 2)


@pytest.mark.parametrize(("hits", "n"), [(18, 20), (0, 7), (7, 7), (3, 11)])
def test_coverage_has_wilsons_interval(hits: int, n: int) -> None:
    rows = [ok(i, m_coverage_95=float(i < hits)) for i in range(n)]
    s = summarise(rows, BOUND)["m_coverage_95"]
    interval = stats.binomtest(hits, n).proportion_ci(0.95, method="wilson")
    assert (s["mean"], s["ci_low"], s["ci_high"]) == pytest.approx((hits / n, *interval), abs=1e-9)
    assert math.isnan(s["excess"])


def test_the_bootstrap_interval_of_the_median_covers_it() -> None:
    """For 41 normal draws a 95 % interval of the median covers 0 in about 95 % of cases; fewer than 84 of 100 has
    probability 1e-5. Its width is near ``2 · 1.96 · 1.2533/√41`` (asymptotic standard error of a median)."""
    rng = np.random.default_rng(4)
    covered, widths = 0, []
    for _ in range(100):
        rows = [ok(i, m_error_pct=10.0 + value) for i, value in enumerate(rng.standard_normal(41))]
        s = summarise(rows, BOUND)["m_error_pct"]
        covered += s["ci_low"] <= 10.0 <= s["ci_high"]
        widths.append(s["ci_high"] - s["ci_low"])
    assert covered >= 84
    assert np.mean(widths) == pytest.approx(2 * 1.96 * 1.2533 / math.sqrt(41), rel=0.2)
