"""Compare recomputed rows of a cell with the stored ones."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from bench.scoring.row import Row, Rows
from bench.scoring.traces import depends_on_clock

SAME_DIGITS = 1e-5
"""Relative difference below which two scores are the same: the archive keeps five significant digits."""
SAME = 5e-5
"""Largest relative difference of a verified score: a tenth of the rounding to the three digits of a table."""
TOLERANCE = 1e-3
"""Largest relative difference of a score that is in no table."""
HIT_ONE_IN = 20
"""The probability of a missed change is stated for a change of one replicate in this number (5 %)."""


def score_differences(before: Sequence[Row], again: Sequence[Row], cell: Sequence[Row]) -> dict[str, float]:
    """Return the largest relative difference of each score that does not depend on the speed of the machine.

    Args:
        before: Stored replicates.
        again: The same replicates, computed again.
        cell: All replicates of the stored cell. A difference is relative to the score, or to its median size over these
            where that is larger: an error that is next to nothing by luck has no digits of its own.
    """
    old, new, whole = map(Rows.from_rows, (before, again, cell))
    differences = {}
    for name in dict.fromkeys([*old.score_names, *new.score_names]):
        if not depends_on_clock(name):
            a, b, sizes = old.scores(name), new.scores(name), np.abs(whole.scores(name))
            size = float(np.median(sizes[np.isfinite(sizes)])) if np.any(np.isfinite(sizes)) else 0.0
            same = (a == b) | (np.isnan(a) & np.isnan(b))
            with np.errstate(invalid="ignore", divide="ignore"):
                gaps = np.abs(a - b) / np.maximum(np.maximum(np.abs(a), np.abs(b)), size)
            differences[name] = float(np.max(np.where(same, 0.0, np.where(np.isfinite(gaps), gaps, np.inf))))
    return differences


def difference(before: Sequence[Row], again: Sequence[Row], cell: Sequence[Row]) -> float:
    """Return the largest of :func:`score_differences`.

    Infinite if a replicate has another status. Messages are not compared, since their wording may be improved.
    """
    old, new = ([row.status for row in rows] for rows in (before, again))
    return max(score_differences(before, again, cell).values(), default=0.0) if old == new else math.inf


def miss_probability(n: int, compared: int) -> float:
    """Return the probability that ``compared`` of ``n`` replicates, drawn without replacement, hold no changed one.

    5 % of the replicates, rounded up, are changed: the hypergeometric distribution at zero (W. Feller, An Introduction
    to Probability Theory and Its Applications, vol. 1, 3rd ed., 1968, section II.6).
    """
    changed = -(-n // HIT_ONE_IN)
    return math.comb(n - changed, compared) / math.comb(n, compared)
