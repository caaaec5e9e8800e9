"""What a record of a free decay would determine, were it longer or taken again."""

from __future__ import annotations

from bench.planning.free_decay import QUANTITIES
from bench.planning.longer import Taken
from bench.reporting.plans.request import TITLES, percent
from bench.reporting.terminal import table, wrapped

FACTORS = (1.25, 1.5, 2.0, 3.0)
"""Multiples of the record's duration that are shown."""
REPEATS = (2, 4)
MEANING = (
    "Percentages are standard errors; those of the record are what it supports, the others follow by ratios of "
    "Cramér-Rao bounds. A longer record continues at the same sampling rate."
)


def longer_page(record: Taken, quantity: str | None, error: float) -> str:
    """Return a table of longer and repeated records, and what it takes to reach a wanted error, if one is wanted."""
    lines = [("as it is", record.duration, record.supported)]
    lines += [(f"{factor:g} times as long", factor * record.duration, record.expected(factor)) for factor in FACTORS]
    lines += [(f"{n} records alike", n * record.duration, record.repeated(n)) for n in REPEATS]
    rows = [
        [title, f"{seconds:.3g}", *(percent(errors[name]) for name in QUANTITIES)] for title, seconds, errors in lines
    ]
    notes = [MEANING, *([_until(record, quantity, error)] if quantity else [])]
    text = table(rows, ["record", "seconds", *(f"{title}, %" for title in TITLES.values())])
    return "\n".join([text, "", *(wrapped(note, "") for note in notes)])


def _until(record: Taken, quantity: str, error: float) -> str:
    """Say what it takes to reach a wanted error."""
    title, factor = TITLES[quantity], record.factor_for(quantity, error)
    now = percent(record.supported[quantity])
    if factor == 1.0:
        return f"The record determines {title} to {now} %, which is enough."
    again = f"{record.number_for(quantity, error)} records like it do"
    if factor is None:
        return f"No longer record determines {title} to {100 * error:g} %: the motion has died away; {again}."
    return (
        f"{(factor - 1.0) * record.duration:.2g} s more bring {title} from {now} to {100 * error:g} %; {again} as well."
    )
