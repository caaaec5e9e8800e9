"""Scores of intervals on siblings: records of one rig, or parts of one record, that determine the same quantities.

There is no truth of a measured record. Its siblings are what an interval of a repeat can be scored on: by the interval
score of its logarithm against the mean of the other siblings, over that of the ideal interval, which is as wide as the
siblings scatter. 1 is ideal; too narrow and too wide intervals both have more. Beside it stand how many intervals cover
that mean, ``R``, the standard deviation between siblings over the median stated standard error, and the median width.

Intervals are rows of a frame whose columns are the fields of :class:`bench.records.intervals.StatedInterval`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from bench.records.intervals import ENDS, HALF

KINDS = {"repeat": "", "record": "record_", "white": "white_"}
"""Kinds of interval, and how the names of their ends begin."""
LEAST_END = 1e-3
"""An end below this part of the value, or below zero, counts as this: a logarithm is needed."""


class IntervalScore(NamedTuple):
    """How intervals of one kind do: ``score`` over the ideal's, how many are ``covered``, R, and the median width.

    ``width`` is the factor by which an interval reaches to either side of its value.
    """

    score: float = math.nan
    covered: int = 0
    ratio: float = math.nan
    width: float = math.nan


def interval_score(stated: pd.DataFrame, kind: str) -> IntervalScore:
    """Score the intervals of a kind of two or more siblings with positive values, on the scale of the logarithm."""
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
    """Return the width of 95 % intervals, and forty times the distance by which they miss the truth.

    T. Gneiting, A. E. Raftery, J. Am. Stat. Assoc. 102:359, 2007, section 6.2.
    """
    missed = np.maximum(low - truth, 0.0) + np.maximum(truth - high, 0.0)
    return np.asarray(high - low + 2.0 / 0.05 * missed)


def compare_siblings(stated: pd.DataFrame, known: float | None = None) -> dict[str, Any]:
    """Compare siblings whose answers for one quantity stand.

    Returns:
        ``n`` answers with their median ``value``; ``error_pct``, the median distance to the known value over it, NaN
        where nothing is known; how many are ``counted``, which have two ends that can be compared, and how many state
        one end only (``limits``); and each field of :class:`IntervalScore` with the kind of interval behind it.
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
    """Take agreements together: median and worst score, sums of the counts, medians of R and of the width."""
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
