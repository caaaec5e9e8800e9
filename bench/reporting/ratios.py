"""Verdicts on the paper's numbers, and on what they imply of k/m and c/m, which none of its tables prints.

Its Table 2 prints an estimate of m, c and k, so their ratios are known but for rounding. Its Tables 3 to 5 print sizes
of errors without signs: a ratio's error lies between those of equal and of opposite signs. To first order that holds of
means over many runs too, by the triangle inequality.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from functools import cache

from bench.reporting.frame import Result, quantity
from bench.reporting.paper import Printed, printed, printed_estimate
from bench.scoring.verdict import Verdict, better_in_both, between, judge

RATIOS = {"k_over_m_error_pct": "k", "c_over_m_error_pct": "c"}
"""By metric, the parameter that is divided by m."""
HALF_ERROR, HALF_VALUE = 0.05, 0.0005
"""Half of the last digit printed: of an error (%) in Tables 3 to 5, and of an estimate in Table 2."""
Range = tuple[float, float]


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
def implied() -> tuple[Printed, ...]:
    """Return what every row of the paper implies of the sizes of the errors (%) of both ratios, in its order."""
    found, values = [], {(p.table, p.row, p.method, p.metric): p for p in printed()}
    for (table, row, method, metric), mass in values.items():
        if metric != "m_error_pct":
            continue
        for ratio, name in RATIOS.items():
            if table == 2:
                low, high, text = _of_estimate(name)
            else:
                error = values[table, row, method, f"{name}_error_pct"].value
                pairs = itertools.product(_either_sign(error), _either_sign(mass.value))
                low, high = sizes(quotient_error(above, below) for above, below in pairs)
                text = f"{low:.1f} to {high:.1f}"
            found.append(Printed(table, row, method, ratio, low, high, mass.snr_db, text))
    return tuple(found)


def _of_estimate(name: str) -> tuple[float, float, str]:
    """Return the size of a ratio's error by the estimate that Table 2 prints, and the error itself."""
    estimate, true = printed_estimate()
    above, below = (
        ((estimate[name] - HALF_VALUE) / true[name], (estimate[name] + HALF_VALUE) / true[name]) for name in (name, "m")
    )
    return *sizes([quotient_error(above, below)]), f"{100.0 * (sum(above) / sum(below) - 1.0):+.2f}"


def _either_sign(error: float) -> tuple[Range, Range]:
    """The ranges of estimate over truth that a printed size of an error (%) leaves."""
    least, most = (error - HALF_ERROR) / 100.0, (error + HALF_ERROR) / 100.0
    return (1.0 - most, 1.0 - least), (1.0 + least, 1.0 + most)


def judged(number: Printed, own: Result, oracle: Result) -> Verdict:
    """Return the verdict of a cell on a number that the paper prints or implies.

    Table 2 prints one estimate, which is no mean of many. The data do not determine k and c, only their ratios to the
    mass, and an error of theirs may follow from that of the mass: ours is better only where it is in the ratio, too.
    """
    # the prior's part of this method's own mean square error: a method that is far off is so for other reasons
    share = own.prior_share.get(quantity(number.metric), 0.0) / max(own.excess(number.metric) ** 2, 1.0)
    errors, least = own.errors(number.metric), oracle.errors(number.metric)
    verdict = between(*(judge(end, errors, least, share) for end in (number.low, number.high)))
    if number.table == 2 and verdict.single != verdict.mean:
        verdict = Verdict(verdict.single, verdict.single, verdict.single)
    where = (number.table, number.row, number.method, quantity(number.metric))
    ratio = next((p for p in implied() if (p.table, p.row, p.method, RATIOS[p.metric]) == where), None)
    if ratio and not own.identifiable.get(quantity(number.metric), True):
        return better_in_both(verdict, judged(ratio, own, oracle))
    return verdict
