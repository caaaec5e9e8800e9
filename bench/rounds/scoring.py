"""Score predictions against the true values of a round, with errors over the Cramér-Rao bound."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bench.scoring.score import LEVELS, interval_score
from bench.scoring.statistics import Z95
from bench.scoring.summary import OUTLIER_FACTOR

if TYPE_CHECKING:
    import pandas as pd

IDEAL = 4.0 / (1.0 - LEVELS[-1]) * math.exp(-(Z95**2) / 2.0) / math.sqrt(2.0 * math.pi)
"""Mean interval score over the bound of the interval value ± 1.96 bound of a normal, efficient estimate: 4 φ(z) / α.

Width 2 z, and 2 / α times the mean miss on either side, φ(z) - z α / 2 (integrated by parts).
"""
DISTURBED = ("coloured noise", "drift")
"""Kinds whose bound assumes white noise; the errors of an efficient estimator may be below or far above it."""
MOST_SCORE = 100.0
"""Upper limit of the interval score over the ideal; an ideal interval about an outlier fit scores at least 27."""


class RoundScores(NamedTuple):
    """Scores of some problems of a round.

    Attributes:
        problems: Number of problems.
        answered: Problems with a value for every requested quantity.
        outliers: Answered problems with an error beyond five times the bound.
        excess: Root mean square of error over bound, of the given values.
        intervals: Number of given intervals.
        covered: Intervals that contain the true value.
        interval_score: Mean interval score (95 %) over the ideal.
        seconds: Median stated time (s).
    """

    problems: int
    answered: int
    outliers: int
    excess: float
    intervals: int
    covered: int
    interval_score: float
    seconds: float


def score_rows(predictions: pd.DataFrame, truth: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of ``truth.csv`` (with ``value`` renamed to ``true``) with predictions and their scores.

    The scores are ``error`` over the bound, infinite without a value; ``covered``, 1 or 0; and ``interval_score`` over
    that of an ideal interval, at most 100. The last two are NaN without an interval.
    """
    rows = truth.rename(columns={"value": "true"}).merge(predictions, on=["scenario", "quantity"], validate="1:1")
    value, low, high, true, bound = (rows[name].to_numpy(float) for name in ("value", "low", "high", "true", "bound"))
    error = np.where(np.isnan(value), np.inf, np.abs(value - true) / bound)
    covered = np.where(np.isnan(low), np.nan, (low <= true) & (true <= high))
    scores = np.minimum(interval_score([(low, high)], true, LEVELS[-1]) / (IDEAL * bound), MOST_SCORE)
    return rows.assign(error=error, covered=covered, interval_score=scores)


def summarise_rows(rows: pd.DataFrame) -> RoundScores:
    """Summarise rows of :func:`score_rows`."""
    problems = rows.groupby("scenario")
    answered = problems["value"].count() == problems.size()
    outliers = int((answered & (problems["error"].max() > OUTLIER_FACTOR)).sum())
    errors = rows.loc[rows["value"].notna(), "error"].to_numpy()
    with np.errstate(over="ignore"):
        excess = math.sqrt(np.mean(errors**2)) if errors.size else math.nan
    intervals, covered, score = rows["covered"].count(), rows["covered"].sum(), float(rows["interval_score"].mean())
    seconds = float(rows["seconds"].median())
    return RoundScores(
        len(problems), int(answered.sum()), outliers, excess, int(intervals), int(covered), score, seconds
    )
