"""Calibration of stated uncertainties: tests of their levels at the true value over many replicates.

If a stated distribution is calibrated, its distribution function at the truth (the probability integral transform) is
uniform over replicates (A. P. Dawid, J. R. Stat. Soc. A 147:278, 1984), and its normal score z is standard normal.
Overconfidence shows in a mean square of z above 1, too wide intervals in one below, a bias in its mean. The mean square
is about 0: an estimate that is always off by much more than it states is too sure, however little it scatters.
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
"""Levels nearer to 0 or 1 than this count as being there: z of 6, and a mean square that is too low, never too high."""


@dataclass(frozen=True)
class Coverage:
    """The share of intervals of a level that cover the true value, with its 95 % interval (Wilson's)."""

    level: float
    share: float
    low: float
    high: float


@dataclass(frozen=True)
class Calibration:
    """Statistics and tests of the levels (n,) of stated distributions at the true values.

    ``rms_z``: root mean square of z. ``p_values`` of three tests: mean of z against 0 (Student's t), its mean square
    against 1 (chi-squared of n), uniformity of the levels (Kolmogorov and Smirnov). ``adjusted``: the same for all
    tests that are judged together, by the method of Y. Benjamini and Y. Hochberg (J. R. Stat. Soc. B 57:289, 1995).
    """

    n: int
    coverage: tuple[Coverage, ...]
    mean_z: float
    rms_z: float
    p_values: tuple[float, float, float]
    adjusted: tuple[float, float, float]

    @property
    def verdict(self) -> str:
        """Name what the tests find at the 5 % level after adjustment."""
        biased, width, shape = (p < LEVEL for p in self.adjusted)
        words = []
        if width:
            words.append("too sure" if self.rms_z > 1.0 else "too wide")
        if biased:
            words.append("biased upwards" if self.mean_z < 0 else "biased downwards")
        if shape and not words:
            words.append("not uniform")
        return ", ".join(words) or "calibrated"


def calibration(levels: np.ndarray) -> Calibration:
    """Judge the levels at the truth of ``n`` replicates, each in [0, 1], alone; raises ValueError for fewer than 5."""
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
    return together([Calibration(n, tuple(coverages), mean, math.sqrt(square), p_values, p_values)])[0]


def together(judged: Sequence[Calibration]) -> list[Calibration]:
    """Adjust p-values over all tests: of the findings, one in twenty is expected to be a false alarm.

    Where every stated distribution is calibrated, there is no finding at all with 95 % probability.
    """
    if not judged:
        return []
    rows = stats.false_discovery_control([p for each in judged for p in each.p_values]).reshape(-1, 3).tolist()
    return [replace(each, adjusted=(a, b, c)) for each, (a, b, c) in zip(judged, rows, strict=True)]
