"""Calibration tests of estimated distributions, from their probability integral transforms over replicates.

The distribution function of a calibrated estimate, evaluated at the true value (the probability integral transform), is
uniform over replicates (A. P. Dawid, J. R. Stat. Soc. A 147:278, 1984), and its normal score z is standard normal.
A mean square of z above 1 shows overconfidence, one below 1 underconfidence, a mean other than 0 a bias. The mean
square is taken about 0, so that a biased estimate with little scatter also counts as overconfident.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from bench.scoring.score import LEVELS
from bench.scoring.statistics import LEVEL, wilson_interval

EXTREME = 1e-9
"""Levels are clipped to this distance from 0 and 1 (|z| at most 6), which can lower the mean square of z, never raise
it."""


@dataclass(frozen=True)
class Coverage:
    """Share of intervals of a nominal level that cover the true value, with the 95 % Wilson interval of that share."""

    level: float
    share: float
    low: float
    high: float


@dataclass(frozen=True)
class Calibration:
    """Calibration statistics and tests of ``n`` replicates.

    ``rms_z``: root mean square of z. ``p_values`` of three tests: mean of z against 0 (Student's t), mean square of z
    against 1 (chi-squared with n degrees of freedom), uniformity of the levels (Kolmogorov-Smirnov). ``adjusted``: the
    p-values after the correction for multiple testing of Y. Benjamini and Y. Hochberg (J. R. Stat. Soc. B 57:289,
    1995).
    """

    n: int
    coverage: tuple[Coverage, ...]
    mean_z: float
    rms_z: float
    p_values: tuple[float, float, float]
    adjusted: tuple[float, float, float]

    @property
    def verdict(self) -> str:
        """Conclusion of the tests at the 5 % level, after the correction for multiple testing."""
        biased, width, shape = (p < LEVEL for p in self.adjusted)
        words = []
        if width:
            words.append("overconfident" if self.rms_z > 1.0 else "underconfident")
        if biased:
            words.append("biased upwards" if self.mean_z < 0 else "biased downwards")
        if shape and not words:
            words.append("not uniform")
        return ", ".join(words) or "calibrated"


def calibration(levels: np.ndarray) -> Calibration:
    """Test the calibration of one method on one quantity.

    Args:
        levels: Distribution function of each estimate at its true value, (n,), in [0, 1].

    Raises:
        ValueError: There are fewer than 5 levels, or one is outside [0, 1].
    """
    levels = np.asarray(levels, float)
    n = levels.size
    if n < 5 or not np.all((levels >= 0) & (levels <= 1)):
        raise ValueError(f"at least 5 levels between 0 and 1 are needed; got {n}")
    coverages = []
    for level in LEVELS:
        inside = np.abs(levels - 0.5) <= level / 2
        coverages.append(Coverage(level, float(inside.mean()), *wilson_interval(int(inside.sum()), n)))
    z = stats.norm.ppf(np.clip(levels, EXTREME, 1.0 - EXTREME))
    mean, square = float(z.mean()), float(np.mean(z**2))
    t = abs(mean) / max(float(z.std(ddof=1)) / math.sqrt(n), 1e-12)
    width = 2.0 * min(stats.chi2.cdf(n * square, n), stats.chi2.sf(n * square, n))
    p_values = (float(2.0 * stats.t.sf(t, n - 1)), float(width), float(stats.kstest(levels, "uniform").pvalue))
    return adjust_p_values([Calibration(n, tuple(coverages), mean, math.sqrt(square), p_values, p_values)])[0]


def adjust_p_values(calibrations: Sequence[Calibration]) -> list[Calibration]:
    """Correct the p-values for multiple testing over all calibrations: a false discovery rate of 5 %.

    If all distributions are calibrated, no test rejects with 95 % probability.
    """
    if not calibrations:
        return []
    rows = stats.false_discovery_control([p for each in calibrations for p in each.p_values]).reshape(-1, 3).tolist()
    return [replace(each, adjusted=(a, b, c)) for each, (a, b, c) in zip(calibrations, rows, strict=True)]
