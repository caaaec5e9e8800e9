"""Verdicts on the paper's numbers, and on what they imply of k/m and c/m, which none of its tables prints.

Its Table 2 prints an estimate of m, c and k, so their ratios are known but for rounding. Its Tables 3 to 5 print sizes
of errors without signs: a ratio's error lies between those of equal and of opposite signs. To first order that holds of
means over many runs too, by the triangle inequality.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache

from bench.reporting.frame import Result, quantity
from bench.reporting.paper import Printed, own_method, printed, printed_estimate
from bench.scoring.verdict import Verdict, better_in_both, between, judge

RATIOS = {"k_over_m_error_pct": "k", "c_over_m_error_pct": "c"}
"""By metric, the parameter that is divided by m."""
HALF_ERROR, HALF_VALUE = 0.05, 0.0005
"""Half of the last digit printed: of an error (%) in Tables 3 to 5, and of an estimate in Table 2."""
Range = tuple[float, float]


@dataclass(frozen=True)
class Bracket:
    """The size of a ratio's error (%), ``low`` to ``high``, that a row of the paper implies, and how it is written.

    ``one_run``: of an estimate, which is one run; else it may be read as a mean of many too.
    """

    table: int
    row: str
    method: str
    metric: str
    low: float
    high: float
    text: str
    one_run: bool = False


def quotient_error(above: Range, below: Range) -> Range:
    """The least and the largest error (%), with its sign, of a quotient of two positive numbers that lie in ranges."""
    return 100.0 * (above[0] / below[1] - 1.0), 100.0 * (above[1] / below[0] - 1.0)


def sizes(ranges: Iterable[Range]) -> Range:
    """The least and the largest size of a number that lies in one of the ranges."""
    found = [
        (0.0 if low <= 0.0 <= high else min(abs(low), abs(high)), max(abs(low), abs(high))) for low, high in ranges
    ]
    return min(low for low, _ in found), max(high for _, high in found)


@cache
def brackets() -> tuple[Bracket, ...]:
    """Return what every row of the paper implies, in its order."""
    found = [_of_estimate(metric) for metric in RATIOS]
    values = {(p.table, p.row, p.method, p.metric): p.value for p in printed() if p.table > 2}
    for place in dict.fromkeys(key[:3] for key in values):
        mass = _either_sign(values[*place, "m_error_pct"])
        for metric, name in RATIOS.items():
            pairs = itertools.product(_either_sign(values[*place, f"{name}_error_pct"]), mass)
            low, high = sizes(quotient_error(above, below) for above, below in pairs)
            found.append(Bracket(*place, metric, low, high, f"{low:.1f} to {high:.1f}"))
    return tuple(found)


def _of_estimate(metric: str) -> Bracket:
    estimate, true = printed_estimate()
    above, below = (
        ((estimate[name] - HALF_VALUE) / true[name], (estimate[name] + HALF_VALUE) / true[name])
        for name in (RATIOS[metric], "m")
    )
    middle = 100.0 * (sum(above) / sum(below) - 1.0)
    row = next(p.row for p in printed() if p.table == 2)
    low, high = sizes([quotient_error(above, below)])
    return Bracket(2, row, own_method(), metric, low, high, f"{middle:+.2f}", one_run=True)


def _either_sign(error: float) -> tuple[Range, Range]:
    """The ranges of estimate over truth that a printed size of an error (%) leaves."""
    least, most = (error - HALF_ERROR) / 100.0, (error + HALF_ERROR) / 100.0
    return (1.0 - most, 1.0 - least), (1.0 + least, 1.0 + most)


def judged(place: Printed, own: Result, oracle: Result) -> Verdict:
    """Return the verdict of a cell on a printed number.

    Table 2 prints one estimate, which is no mean of many. The data do not determine k and c, only their ratios to the
    mass, and an error of theirs may follow from that of the mass: ours is better only where it is in the ratio, too.
    """
    verdict = _judged(place.value, own, oracle, place.metric)
    if place.table == 2 and verdict.single != verdict.mean:
        verdict = Verdict(verdict.single, verdict.single, verdict.single)
    where = (place.table, place.row, place.method, quantity(place.metric))
    implied = next((b for b in brackets() if (b.table, b.row, b.method, RATIOS[b.metric]) == where), None)
    if implied and not own.identifiable.get(quantity(place.metric), True):
        return better_in_both(verdict, judged_bracket(implied, own, oracle))
    return verdict


def judged_bracket(bracket: Bracket, own: Result, oracle: Result) -> Verdict:
    """Return the verdict of a cell on what the paper implies of a ratio."""
    verdict = between(*(_judged(end, own, oracle, bracket.metric) for end in (bracket.low, bracket.high)))
    return Verdict(verdict.single, verdict.single, verdict.single) if bracket.one_run else verdict


def _judged(value: float, own: Result, oracle: Result, metric: str) -> Verdict:
    # the prior's part of this method's own mean square error: a method that is far off is so for other reasons
    share = own.prior_share.get(quantity(metric), 0.0) / max(own.excess(metric) ** 2, 1.0)
    return judge(value, own.errors(metric), oracle.errors(metric), share)
