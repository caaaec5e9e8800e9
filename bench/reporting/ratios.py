"""What the paper's numbers say of k/m and c/m, which free vibration tells and none of its tables prints.

Its Table 2 prints an estimate of m, c and k, so their ratios are known but for rounding. Its Tables 3 to 5 print sizes
of errors without signs: a ratio's error lies between those of equal and of opposite signs. To first order that holds of
means over many runs too, by the triangle inequality.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass

from bench.reporting.frame import Result
from bench.reporting.paper import own_method, printed, printed_estimate
from bench.reporting.tables.tidy import judged
from bench.scoring.verdict import Verdict, between

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


def brackets() -> list[Bracket]:
    """What every row of the paper implies, in its order."""
    found = [_of_estimate(metric) for metric in RATIOS]
    values = {(p.table, p.row, p.method, p.metric): p.value for p in printed() if p.table > 2}
    for place in dict.fromkeys(key[:3] for key in values):
        mass = _either_sign(values[*place, "m_error_pct"])
        for metric, name in RATIOS.items():
            pairs = itertools.product(_either_sign(values[*place, f"{name}_error_pct"]), mass)
            low, high = sizes(quotient_error(above, below) for above, below in pairs)
            found.append(Bracket(*place, metric, low, high, f"{low:.1f} to {high:.1f}"))
    return found


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


def judged_bracket(bracket: Bracket, own: Result, oracle: Result) -> Verdict:
    """The verdict of a cell on what the paper implies of a ratio."""
    found = between(*(judged(end, own, oracle, bracket.metric) for end in (bracket.low, bracket.high)))
    return Verdict(found.single, found.single, found.single) if bracket.one_run else found
