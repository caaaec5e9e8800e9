"""Verdicts on beliefs whose calibration is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from bench.scoring.calibration import calibration


def levels(n: int, sd: float = 1.0, bias: float = 0.0, seed: int = 0) -> np.ndarray:
    """Levels at the truth of estimates with standard error 1 that state ``sd`` and are off by ``bias``, Student's t."""
    rng = np.random.default_rng(seed)
    noise = np.sqrt(rng.chisquare(21, n) / 21)
    return stats.t(21).cdf((0.0 - (bias + rng.standard_normal(n))) / (sd * noise))


def test_a_calibrated_belief_is_called_so_in_nineteen_cases_of_twenty() -> None:
    verdicts = [calibration(levels(300, seed=seed)).verdict for seed in range(100)]
    assert verdicts.count("calibrated") >= 90


@pytest.mark.parametrize("seed", range(5))
def test_half_the_standard_deviation_is_too_sure_and_twice_too_wide(seed: int) -> None:
    assert "too sure" in calibration(levels(100, sd=0.5, seed=seed)).verdict
    assert "too wide" in calibration(levels(100, sd=2.0, seed=seed)).verdict


@pytest.mark.parametrize("seed", range(5))
def test_a_bias_of_half_a_standard_deviation_is_flagged_with_its_side(seed: int) -> None:
    assert "biased upwards" in calibration(levels(200, bias=0.5, seed=seed)).verdict
    assert "biased downwards" in calibration(levels(200, bias=-0.5, seed=seed)).verdict


def test_coverage_is_the_share_of_levels_in_the_middle() -> None:
    """Levels 0.005, 0.015 … 0.995: 50, 80 and 96 of a hundred lie in the middle 50, 80 and 95 %."""
    found = calibration((np.arange(100) + 0.5) / 100)
    assert [c.share for c in found.coverage] == pytest.approx([0.5, 0.8, 0.96], abs=0.011)
    assert all(c.low < c.share < c.high for c in found.coverage)
    assert found.uniform > 0.99
    assert found.verdict == "calibrated"


def test_levels_at_the_ends_and_too_few() -> None:
    assert "too sure" in calibration(np.r_[np.zeros(20), np.ones(20)]).verdict
    with pytest.raises(ValueError, match="at least 5"):
        calibration(np.array([0.2, 0.4]))
