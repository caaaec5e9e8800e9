"""What our replicates say of a printed number, on samples whose quantiles are known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bench.scoring.verdict import judge

SPREAD = np.linspace(0.01, 1.00, 100)
"""0.01, 0.02 … 1.00: 5 % and 95 % quantiles 0.05 and 0.95; means of 100 draws are 0.505 ± 0.029, so 5 % and 95 %
of them lie near 0.457 and 0.553."""
ORACLE = SPREAD / 4
"""Its 0.5 % quantile is 0.0025, that of its means near 0.126 - 2.58 · 0.0072 = 0.108."""


@pytest.mark.parametrize(
    ("paper", "single", "mean"),
    [
        (0.50, "reproduced", "reproduced"),
        (0.20, "reproduced", "ours worse"),
        (0.80, "reproduced", "ours better"),
        (0.06, "reproduced", "ours worse"),
        (0.04, "ours worse", "ours worse"),
        (0.96, "ours better", "ours better"),
    ],
)
def test_a_number_is_placed_as_a_single_run_and_as_a_mean(paper: float, single: str, mean: str) -> None:
    verdict = judge(paper, SPREAD, ORACLE, 0.0)
    assert (verdict.single, verdict.mean) == (single, mean)
    assert verdict.text == (single if single == mean else f"{single} (single run), {mean} (mean)")


def test_the_order_of_replicates_does_not_matter() -> None:
    shuffled = np.random.default_rng(0).permutation(SPREAD)
    assert judge(0.2, shuffled, shuffled / 4, 0.0).single == judge(0.2, SPREAD, ORACLE, 0.0).single


def test_below_the_oracle_in_both_readings_is_incompatible() -> None:
    assert judge(0.002, SPREAD, ORACLE, 0.0).text == "incompatible"


def test_below_the_oracles_mean_only_is_not_incompatible() -> None:
    """One efficient run in many lies there: 0.05 is above the smallest oracle runs."""
    assert judge(0.05, SPREAD, ORACLE, 0.0).text != "incompatible"


def test_what_the_prior_decides_is_not_decidable() -> None:
    verdict = judge(0.002, SPREAD, ORACLE, 0.97)
    assert verdict.text == "not decidable (97 % prior)"
    assert judge(0.5, SPREAD, ORACLE, 0.49).text == "reproduced"


def test_failures_are_infinite_errors() -> None:
    """A tenth failed: the 95 % quantile is infinite, and so is nearly every mean."""
    ours = np.where(np.arange(100) < 90, SPREAD, math.inf)
    verdict = judge(5.0, ours, ORACLE, 0.0)
    assert (verdict.single, verdict.mean) == ("reproduced", "ours worse")


def test_all_failed_is_worse_than_any_number() -> None:
    assert judge(5.0, np.full(20, math.inf), ORACLE, 0.0).text == "ours worse"
