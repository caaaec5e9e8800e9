"""Rows of a cell that were computed again, compared with the stored ones."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median

from bench.contract.estimate import Status
from bench.scoring.row import Row

SAME_DIGITS = 1e-5
"""Relative difference below which two scores are the same: the archive keeps five significant digits."""
SAME = 5e-5
"""Largest relative difference of a verified score: a tenth of what rounding to the three digits of a table takes."""
TOLERANCE = 1e-3
"""Relative difference of a score that no table shows."""
HIT_ONE_IN = 20
"""The change that a comparison may miss alters one replicate in so many: 5 %."""
NUMBER = re.compile(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?")
"""A number in a message, whose last digits depend on the processor."""


@dataclass(frozen=True)
class Verdict:
    """``differences``: worst relative difference by score; ``changed``: what else is not as it was, in words."""

    name: str
    differences: Mapping[str, float]
    changed: tuple[str, ...]


def compare_rows(old: Sequence[Row], new: Sequence[Row], cell: Sequence[Row] = ()) -> Verdict:
    """Compare rows with others of the same replicates: statuses, scores, data.

    Differences are relative to a score, or to the median size of that score over the rows of the ``cell`` (by default
    ``old``) where that is larger: an error that is next to nothing by luck has no digits of its own.
    """
    sizes = _sizes(cell or old)
    differences: dict[str, float] = {}
    changed = []
    for before, after in zip(old, new, strict=True):
        assert before.replicate == after.replicate
        if before.status is not after.status:
            changed.append(f"replicate {before.replicate} was {before.status}, now {after.status}")
        for name in {*before.scores, *after.scores}:
            values = before.scores.get(name, math.nan), after.scores.get(name, math.nan)
            gap = _relative(*values, sizes.get(name, 0.0))
            differences[name] = max(differences.get(name, 0.0), gap)
    other_data = sum(before.data != after.data for before, after in zip(old, new, strict=True))
    worst = max(differences.values(), default=0.0)
    name = "identical"
    if worst > SAME_DIGITS:
        name = "within tolerance"
    if worst > TOLERANCE or changed:
        name = "drifted"
    if other_data:
        changed.append(f"the data of {other_data} replicate(s) differ in their last digits or more")
    return Verdict(name, {k: v for k, v in differences.items() if v > 0}, tuple(changed))


def _sizes(rows: Sequence[Row]) -> dict[str, float]:
    """The median size of each score, of those that are finite."""
    values: dict[str, list[float]] = {}
    for row in rows:
        for name, value in row.scores.items():
            if math.isfinite(value):
                values.setdefault(name, []).append(abs(value))
    return {name: median(found) for name, found in values.items()}


def _relative(before: float, after: float, size: float) -> float:
    if before == after or (math.isnan(before) and math.isnan(after)):
        return 0.0
    if not (math.isfinite(before) and math.isfinite(after)):
        return math.inf
    return abs(before - after) / max(abs(before), abs(after), size)


def difference(before: Sequence[Row], again: Sequence[Row], cell: Sequence[Row]) -> float:
    """Return the largest relative difference of replicates that were computed again.

    Infinite where one has another status or message; the numbers in a message may differ.
    """
    if [_outcome(row) for row in before] != [_outcome(row) for row in again]:
        return math.inf
    return max(compare_rows(before, again, cell).differences.values(), default=0.0)


def _outcome(row: Row) -> tuple[Status, str]:
    return row.status, NUMBER.sub("#", row.message)


def miss_probability(n: int, compared: int) -> float:
    """Return the probability that ``compared`` of ``n`` replicates, drawn without replacement, hold no changed one.

    5 % of the replicates, rounded up, are changed: the hypergeometric distribution at zero (W. Feller, An Introduction
    to Probability Theory and Its Applications, vol. 1, 3rd ed., 1968, section II.6).
    """
    changed = -(-n // HIT_ONE_IN)
    return math.comb(n - changed, compared) / math.comb(n, compared)
