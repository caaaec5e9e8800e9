"""Verdicts on the reproduction of numbers printed in the paper, each read as a single run and as a mean of many runs.

The printed number is subject to chance as well: it is compared with the distribution of one further run, or with that
of the mean of as many further runs. A number produced by our own method is called reproduced in 90 of 100 cases under
either reading.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr
from scipy.stats import binom

BETTER = "ours better"
DECIDED_BY_PRIOR = 0.5
"""A number is not decidable if more than this share of our mean square error is due to the prior."""
TAIL = 0.05
"""A number is not reproduced if it lies in either tail of this probability of our runs or means."""
INCOMPATIBLE_TAIL = 0.005
"""A number is incompatible if it lies in the lower tail of this probability of the oracle's runs and means."""


@dataclass(frozen=True)
class Verdict:
    """Verdicts for the readings as a ``single`` run and as a ``mean`` of many; ``text`` is printed in the table."""

    single: str
    mean: str
    text: str


def judge(paper: float, errors: np.ndarray, oracle: np.ndarray, prior_share: float) -> Verdict:
    """Compare a printed number with our errors and those of the oracle.

    The number is reproduced if it lies in neither 5 % tail of our runs (single run) or of their mean (mean of many);
    in the lower tail ours is worse, in the upper tail ours is better. It is not decidable if the prior dominates. It is
    incompatible if it is below the 0.5 % quantile of the oracle's runs and of their mean.

    Args:
        paper: The printed number.
        errors: Our errors (n,), infinite for failures.
        oracle: Errors of the oracle (n,).
        prior_share: Share of our mean square error that is due to the prior.
    """
    if prior_share > DECIDED_BY_PRIOR:
        return Verdict("not decidable", "not decidable", f"not decidable ({100 * prior_share:.0f} % prior)")
    verdict = _of_readings(_side(run_tails(paper, errors)), _side(mean_tails(paper, errors)))
    least = np.quantile(oracle, INCOMPATIBLE_TAIL, method="inverted_cdf")
    if paper < least and mean_tails(paper, oracle)[0] < INCOMPATIBLE_TAIL:
        return Verdict(verdict.single, verdict.mean, "incompatible")
    return verdict


def between(low: Verdict, high: Verdict) -> Verdict:
    """Return the verdict on a number that lies between two others: open wherever their verdicts differ."""
    if low.text == high.text:
        return low
    return _of_readings(*(a if a == b else "open" for a, b in ((low.single, high.single), (low.mean, high.mean))))


def better_in_both(verdict: Verdict, other: Verdict) -> Verdict:
    """Return the verdict, open for each reading under which ours is better by this verdict but not by the other."""
    pairs = ((verdict.single, other.single), (verdict.mean, other.mean))
    readings = ["open" if a == BETTER != b else a for a, b in pairs]
    return _of_readings(*readings) if readings != [verdict.single, verdict.mean] else verdict


def _of_readings(single: str, mean: str) -> Verdict:
    return Verdict(single, mean, single if single == mean else f"{single} (single run), {mean} (mean)")


def run_tails(value: float, errors: np.ndarray) -> tuple[float, float]:
    """Return the probabilities that one further run is at most, and at least, ``value``: by its rank among n + 1."""
    n = errors.size + 1
    return (1 + int(np.sum(errors <= value))) / n, (1 + int(np.sum(errors >= value))) / n


def mean_tails(value: float, errors: np.ndarray) -> tuple[float, float]:
    """Return the probabilities that the mean of n further runs is at most, and at least, ``value``.

    Student's t distribution, where the variance of the difference of two means is the sum of their variances. A mean
    that contains a failed run is infinite; the probability that n further runs contain none is that of a resample of a
    resample of our runs.
    """
    n, good = errors.size, errors[np.isfinite(errors)]
    failed = np.arange(n + 1)
    no_failure = float(np.sum(binom.pmf(failed, n, 1.0 - good.size / n) * (1.0 - failed / n) ** n))
    if good.size < 2:
        return no_failure, 1.0
    error = float(good.std(ddof=1)) * math.sqrt(1.0 / good.size + 1.0 / n)
    t = (value - float(good.mean())) / max(error, np.finfo(float).tiny)
    below, above = (float(stdtr(good.size - 1, side)) for side in (t, -t))
    return no_failure * below, no_failure * above + (1.0 - no_failure)


def _side(tails: tuple[float, float]) -> str:
    if tails[0] <= TAIL:
        return "ours worse"
    return BETTER if tails[1] <= TAIL else "reproduced"
