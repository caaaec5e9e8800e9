"""Verdicts on distributions whose calibration is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from bench.scoring.calibration import adjust_p_values, calibration


def levels(n: int, sd: float = 1.0, bias: float = 0.0, seed: int = 0) -> np.ndarray:
    """Levels at the truth of estimates with standard error 1 that state ``sd`` and are off by ``bias``, Student's t."""
    rng = np.random.default_rng(seed)
    noise = np.sqrt(rng.chisquare(21, n) / 21)
    return stats.t(21).cdf((0.0 - (bias + rng.standard_normal(n))) / (sd * noise))


def test_a_calibrated_belief_is_called_so_in_nineteen_cases_of_twenty() -> None:
    verdicts = [calibration(levels(300, seed=seed)).verdict for seed in range(100)]
    assert verdicts.count("calibrated") >= 90


@pytest.mark.parametrize("seed", range(5))
def test_halved_standard_deviations_are_overconfident_and_doubled_ones_underconfident(seed: int) -> None:
    assert "overconfident" in calibration(levels(100, sd=0.5, seed=seed)).verdict
    assert "underconfident" in calibration(levels(100, sd=2.0, seed=seed)).verdict


@pytest.mark.parametrize("seed", range(5))
def test_a_bias_of_half_a_standard_deviation_is_flagged_with_its_side(seed: int) -> None:
    assert "biased upwards" in calibration(levels(200, bias=0.5, seed=seed)).verdict
    assert "biased downwards" in calibration(levels(200, bias=-0.5, seed=seed)).verdict


def test_coverage_is_the_share_of_levels_in_the_middle() -> None:
    """Levels 0.005, 0.015 … 0.995: 50, 80 and 96 of a hundred lie in the middle 50, 80 and 95 %."""
    found = calibration((np.arange(100) + 0.5) / 100)
    assert [c.share for c in found.coverage] == pytest.approx([0.5, 0.8, 0.96], abs=0.011)
    assert all(c.low < c.share < c.high for c in found.coverage)
    assert found.p_values[2] > 0.99
    assert found.verdict == "calibrated"


@pytest.mark.parametrize("end", [0.0, 1.0])
def test_always_far_off_on_one_side_is_too_sure_however_little_it_scatters(end: float) -> None:
    """No interval holds the truth: it cannot be too wide. Levels at the very end have no scatter at all."""
    side = "biased upwards" if end == 0.0 else "biased downwards"
    assert calibration(np.full(200, end)).verdict == f"overconfident, {side}"
    near = np.abs(end - np.random.default_rng(1).uniform(0.001, 0.004, 200))
    found = calibration(near)
    assert found.coverage[-1].share == 0.0
    assert found.verdict == f"overconfident, {side}"


@pytest.mark.slow
def test_a_table_of_calibrated_lines_has_no_finding_in_nineteen_cases_of_twenty() -> None:
    """Forty tables of twenty lines: at 5 % a table, two are expected, and eight would be one chance in a thousand.

    Line by line at 5 %, two tables of three would have a finding.
    """
    tables = [[calibration(levels(60, seed=20 * i + j)) for j in range(20)] for i in range(40)]
    alone = sum(any(one.verdict != "calibrated" for one in table) for table in tables)
    assert sum(any(one.verdict != "calibrated" for one in adjust_p_values(table)) for table in tables) < 8
    assert alone > 16


def test_lines_that_are_wrong_are_found_among_calibrated_ones() -> None:
    """Adjusted as the definition says: the i-th least of m p-values times m/i, and none above a later one."""
    found = adjust_p_values([calibration(levels(200, sd=0.5 if i < 5 else 1.0, seed=i)) for i in range(30)])
    assert all("overconfident" in one.verdict for one in found[:5])
    assert sum(one.verdict != "calibrated" for one in found[5:]) <= 2
    p, adjusted = (
        np.array([values for one in found for values in getattr(one, name)]) for name in ("p_values", "adjusted")
    )
    order = np.argsort(p)
    by_hand = [min(min(p[order[j]] * p.size / (j + 1) for j in range(i, p.size)), 1.0) for i in range(p.size)]
    assert adjusted[order] == pytest.approx(by_hand)
    assert adjust_p_values([]) == []
