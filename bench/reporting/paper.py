"""The numbers that the paper prints in its Tables 2 to 5, what they imply of k/m and c/m, and the verdicts on them.

Its Table 2 prints an estimate of m, c and k, so their ratios are known but for rounding. Its Tables 3 to 5 print sizes
of errors without signs: a ratio's error lies between those of equal and of opposite signs. To first order that holds of
means over many runs too, by the triangle inequality.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from bench.reporting.frame import ERROR, Result, quantity
from bench.reporting.labels import cards
from bench.scoring.verdict import Verdict, better_in_both, between, judge

ROWS = {2: "identified", 3: "comparison"}
"""Names of the single rows of Tables 2 and 3; those of Tables 4 and 5 are named in the file."""
COLUMNS = {"rmse": "displacement_rmse", **{name: name for name in ("m_error_pct", "c_error_pct", "k_error_pct")}}
"""Of each metric its column in ``bench/data/paper_tables.csv``."""
RATIOS = {"k_over_m_error_pct": "k", "c_over_m_error_pct": "c"}
"""By metric, the parameter that is divided by m."""
HALF_ERROR, HALF_VALUE = 0.05, 0.0005
"""Half of the last digit printed: of an error (%) in Tables 3 to 5, and of an estimate in Table 2."""
Range = tuple[float, float]


@dataclass(frozen=True)
class Printed:
    """One number of the paper: where it stands, and what it is; ``method`` is as the paper's file calls it.

    A number that it only implies lies between ``low`` and ``high`` and is written as ``text``; others are both.
    """

    table: int
    row: str
    method: str
    metric: str
    low: float
    high: float
    snr_db: float
    text: str = ""

    @property
    def value(self) -> float:
        """The number, where it is printed."""
        return self.low


@cache
def _lines() -> tuple[dict[str, str], ...]:
    text = files("bench").joinpath("data", "paper_tables.csv").read_text(encoding="utf-8")
    return tuple(csv.DictReader(line for line in text.splitlines() if not line.startswith("#")))


@cache
def printed() -> tuple[Printed, ...]:
    """All numbers of the paper, in its order."""
    numbers = []
    for line in _lines():
        table, snr = int(line["table"]), float(line["snr_db"])
        for metric, column in COLUMNS.items():
            if line[column]:
                value, row = float(line[column]), ROWS.get(table, line["row"])
                numbers.append(Printed(table, row, line["method"], metric, value, value, snr))
    return tuple(numbers)


@cache
def implied() -> tuple[Printed, ...]:
    """Return what every row of the paper implies of the sizes of the errors (%) of both ratios, in its order."""
    numbers, errors = [], {(p.table, p.row, p.method, p.metric): p for p in printed()}
    for mass in (number for number in printed() if number.metric == "m" + ERROR):
        place = (mass.table, mass.row, mass.method)
        for ratio, name in RATIOS.items():
            if mass.table == 2:
                above, below = (_estimated(n) for n in (name, "m"))
            else:
                above, below = (_either_sign(errors[*place, n + ERROR].value) for n in (name, "m"))
            low, high = size_of_error(above, below)
            middle = 100.0 * (sum(above[0]) / sum(below[0]) - 1.0)
            text = f"{middle:+.2f}" if mass.table == 2 else f"{low:.1f} to {high:.1f}"
            numbers.append(Printed(*place, ratio, low, high, mass.snr_db, text))
    return tuple(numbers)


def size_of_error(above: Sequence[Range], below: Sequence[Range]) -> Range:
    """The least and the largest size of the error (%) of a quotient of two positive numbers that lie in ranges."""
    ends = [(100.0 * (a[0] / b[1] - 1.0), 100.0 * (a[1] / b[0] - 1.0)) for a in above for b in below]
    return min(max(low, -high, 0.0) for low, high in ends), max(max(-low, high) for low, high in ends)


def _estimated(name: str) -> list[Range]:
    """The range of estimate over truth that Table 2 prints of a parameter."""
    line = next(line for line in _lines() if line["table"] == "2")
    estimate = {name: float(value) for name, value in re.findall(r"\b([mck])=([\d.]+)", line["note"])}[name]
    return [((estimate - HALF_VALUE) / float(line[name]), (estimate + HALF_VALUE) / float(line[name]))]


def _either_sign(error: float) -> list[Range]:
    """The ranges of estimate over truth that a printed size of an error (%) leaves."""
    least, most = (error - HALF_ERROR) / 100.0, (error + HALF_ERROR) / 100.0
    return [(1.0 - most, 1.0 - least), (1.0 + least, 1.0 + most)]


def judged(number: Printed, result: Result, oracle: Result) -> Verdict:
    """Return the verdict of a cell on a number that the paper prints or implies.

    Table 2 prints one estimate, which is no mean of many. The data do not determine k and c, only their ratios to the
    mass, and an error of theirs may follow from that of the mass: ours is better only where it is in the ratio, too.
    """
    # the prior's part of this method's own mean square error: a method that is far off is so for other reasons
    share = result.prior_share.get(quantity(number.metric), 0.0) / max(result.excess(number.metric) ** 2, 1.0)
    errors, least = result.errors(number.metric), oracle.errors(number.metric)
    verdict = between(*(judge(end, errors, least, share) for end in (number.low, number.high)))
    if number.table == 2 and verdict.single != verdict.mean:
        verdict = Verdict(verdict.single, verdict.single, verdict.single)
    where = (number.table, number.row, number.method, quantity(number.metric))
    ratio = next((p for p in implied() if (p.table, p.row, p.method, RATIOS[p.metric]) == where), None)
    if ratio and not result.identifiable.get(quantity(number.metric), True):
        return better_in_both(verdict, judged(ratio, result, oracle))
    return verdict


def paper_number(table: int | None, row: str, label: str, metric: str) -> Printed | None:
    """Return the paper's number that a method of ours stands beside; None where there is none."""
    card = cards().get(label)
    place = (table, row, card.paper if card else "", metric)
    return next((p for p in printed() if (p.table, p.row, p.method, p.metric) == place), None)


def row_name(table: int, system: str, snr_db: float) -> str:
    """The name of the row of a table in which a scenario stands."""
    return system.rpartition("_")[2] if table == 4 else ROWS.get(table, f"{snr_db:g}")


def own_method() -> str:
    """The method that the paper proposes, whose estimate its Table 2 gives."""
    return next(p.method for p in printed() if p.table == 2)
