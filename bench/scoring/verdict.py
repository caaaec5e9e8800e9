"""What our replicates say of a number that the paper prints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.scoring.resampling import shares

DECIDED_BY_PRIOR = 0.5
"""A number is not decidable where more than this part of our mean square error is the prior's."""


@dataclass(frozen=True)
class Verdict:
    """``single`` and ``mean``: how the number reads as one run and as a mean of many; ``text`` for the table."""

    single: str
    mean: str
    text: str


def judge(paper: float, ours: np.ndarray, oracle: np.ndarray, prior_share: float) -> Verdict:
    """The verdict on one printed number from our errors ``ours`` (n,), failures as infinities, and the oracle's.

    Reproduced: between the 5 % and 95 % quantiles of our replicates (single run), or of the means of as many
    replicates drawn from them with replacement (mean of many). Below: ours worse. Above: ours better. Not decidable
    where ``prior_share``, the prior's part of our mean square error, says that the prior decides. Incompatible where it
    is below the oracle's 0.5 % quantile in both readings.
    """
    if prior_share > DECIDED_BY_PRIOR:
        text = f"not decidable ({100 * prior_share:.0f} % prior)"
        return Verdict("not decidable", "not decidable", text)
    single = _place(paper, np.sort(ours))
    mean = _place(paper, _means(ours))
    low_single = np.quantile(np.sort(oracle), 0.005, method="inverted_cdf")
    low_mean = np.quantile(_means(oracle), 0.005, method="inverted_cdf")
    if paper < low_single and paper < low_mean:
        return Verdict(single, mean, "incompatible")
    return Verdict(single, mean, single if single == mean else f"{single} (single run), {mean} (mean)")


def _place(value: float, sample: np.ndarray) -> str:
    low, high = np.quantile(sample, [0.05, 0.95], method="inverted_cdf")
    if value < low:
        return "ours worse"
    return "ours better" if value > high else "reproduced"


def _means(values: np.ndarray) -> np.ndarray:
    finite, drawn = np.isfinite(values), shares(values.size)
    return np.asarray(np.where(drawn @ ~finite > 0, np.inf, drawn @ np.where(finite, values, 0.0)))
