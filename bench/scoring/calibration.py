"""Whether a stated uncertainty means what it says: tests of the levels at the truth over many replicates.

If a belief is calibrated, its distribution function at the truth (the probability integral transform) is uniform over
replicates (A. P. Dawid, J. R. Stat. Soc. A 147:278, 1984), and its normal score z is standard normal. Too sure shows in
a spread of z above 1, too wide in one below, a bias in its mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from bench.scoring.comparison import LEVEL, holm
from bench.scoring.summary import wilson_interval

LEVELS = (0.50, 0.80, 0.95)
EXTREME = 1e-9
"""Levels nearer to 0 or 1 than this count as being there: z of about 6."""


@dataclass(frozen=True)
class Coverage:
    """How often intervals of a level held the truth, with its 95 % interval (Wilson's)."""

    level: float
    share: float
    low: float
    high: float


@dataclass(frozen=True)
class Calibration:
    """What the levels at the truth (n,) say of a belief. ``uniform`` is the p-value of Kolmogorov and Smirnov."""

    n: int
    coverage: tuple[Coverage, ...]
    mean_z: float
    sd_z: float
    uniform: float
    verdict: str


def calibration(levels: np.ndarray) -> Calibration:
    """Judge the levels at the truth of ``n`` replicates, each in [0, 1]; raises ValueError for fewer than 5.

    The verdict is by three tests with Holm's adjustment at the 5 % level: mean of z against 0 (Student's t), its
    variance against 1 (chi-squared), and uniformity.
    """
    levels = np.asarray(levels, float)
    if levels.size < 5 or not np.all((levels >= 0) & (levels <= 1)):
        raise ValueError(f"at least 5 levels between 0 and 1 are needed; got {levels.size}")
    n = levels.size
    z = stats.norm.ppf(np.clip(levels, EXTREME, 1.0 - EXTREME))
    mean, sd = float(z.mean()), float(z.std(ddof=1))
    tail = stats.chi2.cdf((n - 1) * sd**2, n - 1)
    uniform = float(stats.kstest(levels, "uniform").pvalue)
    t = abs(mean) / max(sd / np.sqrt(n), 1e-12)
    biased, spread, shape = holm([2.0 * stats.t.sf(t, n - 1), 2.0 * min(tail, 1.0 - tail), uniform]) < LEVEL
    words = []
    if spread:
        words.append("too sure" if sd > 1.0 else "too wide")
    if biased:
        words.append("biased upwards" if mean < 0 else "biased downwards")
    if shape and not words:
        words.append("not uniform")
    return Calibration(n, _coverages(levels), mean, sd, uniform, ", ".join(words) or "calibrated")


def _coverages(levels: np.ndarray) -> tuple[Coverage, ...]:
    found = []
    for level in LEVELS:
        inside = np.abs(levels - 0.5) <= level / 2
        found.append(Coverage(level, float(inside.mean()), *wilson_interval(int(inside.sum()), inside.size)))
    return tuple(found)
