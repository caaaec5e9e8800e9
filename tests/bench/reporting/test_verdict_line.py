"""The verdict below the table of a cell, on summaries made to be good, biased, overconfident or without estimates."""

from __future__ import annotations

import math
from typing import Any

import pytest
from scipy import stats

from bench import Status
from bench.reporting.verdict import GOOD as NO_FAULT
from bench.reporting.verdict import verdict
from bench.scoring.row import Row
from bench.store.stored_cell import StoredCell


def cell(excess: dict[str, float], coverage: dict[str, float], ok: int = 100, failed: int = 0) -> StoredCell:
    rows = [Row(i, Status.OK if i < ok else Status.DIVERGED) for i in range(ok + failed)]
    summary: dict[str, Any] = {f"{name}_error_pct": {"excess": value} for name, value in excess.items()}
    summary |= {f"{name}_coverage_95": {"mean": value} for name, value in coverage.items()}
    return StoredCell("0" * 20, {}, rows, summary, {}, {"m": False}, 0.0)


AT_BOUND = "accuracy: at the Cramér-Rao bound"
CALIBRATED = "95 % intervals: calibrated"
GOOD = {"k_over_m": 1.05, "c_over_m": 0.98}
COVERAGE = {"k_over_m": 0.95, "c_over_m": 0.93}


@pytest.mark.parametrize(
    ("excess", "coverage", "text"),
    [
        (GOOD, COVERAGE, NO_FAULT),
        # 100 errors: a root mean square is within about 14 % of its own, so 1.3 may be chance and 1.5 may not
        ({**GOOD, "k_over_m": 1.3}, COVERAGE, NO_FAULT),
        (
            {**GOOD, "k_over_m": 1.5},
            COVERAGE,
            f"accuracy: 1.50 times the bound in k/m, at the bound in others; {CALIBRATED}",
        ),
        ({"k_over_m": 9.0, "c_over_m": 2.0}, COVERAGE, f"accuracy: 9.00 times the bound in k/m; {CALIBRATED}"),
        # of 100 calibrated intervals fewer than 90 cover the true value with a probability below 1/40
        (GOOD, {**COVERAGE, "c_over_m": 0.90}, NO_FAULT),
        (GOOD, {**COVERAGE, "c_over_m": 0.89}, f"{AT_BOUND}; 95 % intervals: overconfident (89 % cover the true c/m)"),
        (GOOD, {}, f"{AT_BOUND}; 95 % intervals: not stated"),
        # m is not identifiable: its error is due to the prior
        ({**GOOD, "m": 30.0}, {**COVERAGE, "m": 0.1}, NO_FAULT),
    ],
)
def test_accuracy_and_intervals_are_judged(excess: dict[str, float], coverage: dict[str, float], text: str) -> None:
    assert verdict(cell(excess, coverage)) == text


@pytest.mark.parametrize("n", [10, 100])
def test_errors_too_small_to_be_chance_are_never_called_good(n: int) -> None:
    """Chi-square of n at a probability of a millionth: 0.197 and 0.680 of the bound (tables of the gamma function)."""
    least = math.sqrt(stats.gamma.ppf(1e-6, n / 2, scale=2.0) / n)
    # the last: a bound of 80 % is that of a linearisation, and no limit
    for factor, bound, fault in ((0.99, 3.0, True), (1.01, 3.0, False), (0.99, 80.0, False)):
        stored = cell({"k_over_m": factor * least, "c_over_m": 1.0}, COVERAGE, n)
        for summary in (stored.summary["k_over_m_error_pct"], stored.summary["c_over_m_error_pct"]):
            summary["bound"] = bound
        assert (verdict(stored) == NO_FAULT) == (not fault)
        assert verdict(stored).startswith("accuracy: below the bound by more than chance allows (k/m)") == fault


def test_fits_without_an_estimate_are_counted_and_few_fits_give_no_verdict() -> None:
    assert verdict(cell(GOOD, COVERAGE, 95, 5)) == f"{NO_FAULT}; 5 of 100 fits without an estimate"
    assert verdict(cell(GOOD, COVERAGE, 4, 96)) == "no verdict: at least 5 successful fits required (4 available)"
    assert verdict(cell({"k_over_m": math.nan}, {})).startswith("no verdict: no quantity is identifiable")
