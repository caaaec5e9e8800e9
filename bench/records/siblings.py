"""Scores of intervals on siblings: records of one test rig, or parts of one record, with the same true parameters.

The true parameters of measured records are unknown, so an interval is compared with the mean of the other siblings: by
its interval score on the log scale over that of the ideal interval, whose width is the scatter of the siblings. The
score of an ideal interval is 1; overconfident and underconfident intervals score higher. Further scores are the
coverage of that mean, ``R`` (standard deviation between siblings over the median standard error) and the median width.

Intervals are rows of a data frame whose columns are the fields of :class:`bench.records.intervals.StatedInterval`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from bench.records.intervals import ENDS, HALF

KINDS = {"repeat": "", "record": "record_", "white": "white_"}
"""Kinds of interval, with the prefix of the columns of their ends."""
LEAST_END = 1e-3
"""Lower limit of an end over the value, as logarithms are compared."""


class IntervalScore(NamedTuple):
    """Scores of intervals of one kind.

    Attributes:
        score: Mean interval score over that of the ideal interval.
        covered: Number of intervals that cover the mean of the other siblings.
        ratio: R, the standard deviation between siblings over the median standard error.
        width: Median factor between the value and either end.
    """

    score: float = math.nan
    covered: int = 0
    ratio: float = math.nan
    width: float = math.nan


def interval_score(stated: pd.DataFrame, kind: str) -> IntervalScore:
    """Score the intervals of a kind on the log scale, for two or more siblings with positive values."""
    sizes = stated["value"].to_numpy(float)
    ends = (stated[f"{KINDS[kind]}{end}"].to_numpy(float) for end in ("low", "high"))
    values, (low, high) = np.log(sizes), (np.log(np.maximum(end, LEAST_END * sizes)) for end in ends)
    others = (np.sum(values) - values) / (values.size - 1)
    spread, half = float(np.std(values, ddof=1)), float(np.median(high - low)) / 2.0
    ideal = _gneiting_raftery(values - HALF * spread, values + HALF * spread, others)
    return IntervalScore(
        score=float(np.mean(_gneiting_raftery(low, high, others)) / np.mean(ideal)) if spread > 0 else math.nan,
        covered=int(np.sum((low <= others) & (others <= high))),
        ratio=HALF * spread / half if half > 0 else math.nan,
        width=math.exp(half),
    )


def _gneiting_raftery(low: np.ndarray, high: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return the interval scores: the width of 95 % intervals plus forty times the distance to an uncovered value.

    T. Gneiting, A. E. Raftery, J. Am. Stat. Assoc. 102:359, 2007, section 6.2.
    """
    missed = np.maximum(low - truth, 0.0) + np.maximum(truth - high, 0.0)
    return np.asarray(high - low + 2.0 / 0.05 * missed)


def compare_siblings(stated: pd.DataFrame, known: float | None = None) -> dict[str, Any]:
    """Compare the intervals of a quantity between siblings.

    Args:
        stated: Intervals of trusted estimates, one row per sibling.
        known: Published value.

    Returns:
        The number ``n`` of intervals and their median ``value``; ``error_pct``, the median relative distance to the
        published value (%), NaN without one; ``counted``, the number of two-sided intervals that are scored, and
        ``limits``, that of one-sided ones; and the fields of :class:`IntervalScore` with the kind as a suffix.
    """
    compared = stated[(stated["limit"] == "") & (stated["value"] > 0) & np.isfinite(stated[list(ENDS)]).all(axis=1)]
    counted = len(compared) if len(compared) > 1 else 0
    scores = {kind: interval_score(compared, kind) if counted else IntervalScore() for kind in KINDS}
    return {
        "n": len(stated),
        "value": stated["value"].median(),
        "error_pct": math.nan if known is None else 100.0 * (stated["value"] - known).abs().median() / abs(known),
        **{f"{name}_{kind}": value for kind, score in scores.items() for name, value in score._asdict().items()},
        "counted": counted,
        "limits": int((stated["limit"] != "").sum()),
    }


def total(agreements: pd.DataFrame, kind: str) -> dict[str, float]:
    """Summarise comparisons: median and worst score, sums of the counts, medians of R and of the width."""
    several = agreements[agreements["counted"] > 0]
    column = {name: several[f"{name}_{kind}"] for name in IntervalScore._fields}
    return {
        "score": column["score"].median(),
        "worst": column["score"].max(),
        "covered": column["covered"].sum(),
        "counted": several["counted"].sum(),
        "ratio": column["ratio"].median(),
        "width": column["width"].median(),
    }
