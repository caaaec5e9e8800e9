"""Verdicts on numbers that the paper prints, each read as one run and as a mean of many.

A number under judgement has luck of its own, as large as that of what it is compared with: one more run is placed among
our runs, and another mean of as many runs beside our mean. So a number from our own method is called reproduced in 90
cases of 100, under either reading.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr
from scipy.stats import binom

BETTER = "ours better"
DECIDED_BY_PRIOR = 0.5
"""A number is not decidable where more than this part of our mean square error is the prior's."""
OUTSIDE = 0.05
"""A number that fewer of our own method's runs or means pass, on either side, is not reproduced."""
LUCK = 0.005
"""What fewer of the oracle's runs and means come down to is incompatible."""


@dataclass(frozen=True)
class Verdict:
    """``single`` and ``mean``: how the number reads as one run and as a mean of many; ``text`` for the table."""

    single: str
    mean: str
    text: str


def judge(paper: float, ours: np.ndarray, oracle: np.ndarray, prior_share: float) -> Verdict:
    """Judge one printed number by our errors ``ours`` (n,), failures as infinities, and the oracle's.

    Reproduced: more than 5 % of our runs (single run) or of means of as many (mean of many) would be so small, and more
    than 5 % so large. Else below: ours worse; above: ours better. Not decidable where ``prior_share``, the prior's part
    of our mean square error, says that the prior decides. Incompatible where it is below the 0.5 % quantile of the
    oracle's runs, the least of fewer than 200, and of its means.
    """
    if prior_share > DECIDED_BY_PRIOR:
        return Verdict("not decidable", "not decidable", f"not decidable ({100 * prior_share:.0f} % prior)")
    verdict = _of_readings(_side(run_tails(paper, ours)), _side(mean_tails(paper, ours)))
    least = np.quantile(oracle, LUCK, method="inverted_cdf")
    if paper < least and mean_tails(paper, oracle)[0] < LUCK:
        return Verdict(verdict.single, verdict.mean, "incompatible")
    return verdict


def between(low: Verdict, high: Verdict) -> Verdict:
    """Judge a number known to lie between two: what both have in common, else open."""
    if low.text == high.text:
        return low
    return _of_readings(*(a if a == b else "open" for a, b in ((low.single, high.single), (low.mean, high.mean))))


def better_in_both(verdict: Verdict, other: Verdict) -> Verdict:
    """Return a verdict that leaves open under which readings ours is better, unless the other verdict says so, too."""
    readings = ((verdict.single, other.single), (verdict.mean, other.mean))
    found = ["open" if a == BETTER != b else a for a, b in readings]
    return _of_readings(*found) if found != [verdict.single, verdict.mean] else verdict


def _of_readings(single: str, mean: str) -> Verdict:
    return Verdict(single, mean, single if single == mean else f"{single} (single run), {mean} (mean)")


def run_tails(value: float, ours: np.ndarray) -> tuple[float, float]:
    """Return the probabilities that one more run beside ours (n,) is so small, and so large: by rank among n + 1."""
    return (1 + int(np.sum(ours <= value))) / (ours.size + 1), (1 + int(np.sum(ours >= value))) / (ours.size + 1)


def mean_tails(value: float, ours: np.ndarray) -> tuple[float, float]:
    """Return the probabilities that another mean of as many runs is so small, and so large.

    By Student's t for a new mean: the variance of the difference of the two is that of both. A mean with a failed run
    is infinite; another n runs have none with the probability that a resample of a resample of ours has none.
    """
    n, good = ours.size, ours[np.isfinite(ours)]
    failed = np.arange(n + 1)
    spared = float(np.sum(binom.pmf(failed, n, 1.0 - good.size / n) * (1.0 - failed / n) ** n))
    if good.size < 2:
        return spared, 1.0
    error = float(good.std(ddof=1)) * math.sqrt(1.0 / good.size + 1.0 / n)
    t = (value - float(good.mean())) / max(error, np.finfo(float).tiny)
    below, above = (float(stdtr(good.size - 1, side)) for side in (t, -t))
    return spared * below, spared * above + (1.0 - spared)


def _side(tails: tuple[float, float]) -> str:
    if tails[0] <= OUTSIDE:
        return "ours worse"
    return BETTER if tails[1] <= OUTSIDE else "reproduced"
