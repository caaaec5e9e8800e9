"""What a record of a free decay would tell, if it had gone on for longer or were taken again."""

from __future__ import annotations

from collections.abc import Sequence

from bench.commands.design_request import TITLES, percent, wanted
from bench.commands.fields import read_fields
from bench.config.atlas import on_the_bound
from bench.config.choices import check_choice
from bench.errors import InputError
from bench.planning.free_decay import QUANTITIES
from bench.planning.longer import Taken
from bench.reporting.terminal import table, wrapped

FACTORS = (1.25, 1.5, 2.0, 3.0)
"""Times its duration, for which it is said what a record would tell."""
AGAIN = (2, 4)


def gone_on(arguments: Sequence[str]) -> int:
    """What a record would tell, had it gone on or were it taken again."""
    from bench.config.overrides import read_overrides
    from bench.planning.taken import taken

    own = {"given": "", "want": "", "method": on_the_bound()[0]}
    fields = read_fields([one for one in arguments if one.partition("=")[0] in own], own)
    rest = [one for one in arguments if one.partition("=")[0] not in own]
    want = wanted(fields["want"]) if fields["want"] else None
    given = [f"data={fields['given']}", f"method={fields['method']}", *rest]
    check_choice("method", fields["method"])
    try:
        record = taken(read_overrides(given))
    except InputError as error:
        raise InputError("given" if error.field == "data" else error.field, error.value, error.remedy) from None
    lines = [("as it is", record.duration, record.supported)]
    lines += [(f"{factor:g} times as long", factor * record.duration, record.expected(factor)) for factor in FACTORS]
    lines += [(f"{number} records alike", number * record.duration, record.repeated(number)) for number in AGAIN]
    rows = [[title, f"{seconds:.3g}", *(percent(told[name]) for name in QUANTITIES)] for title, seconds, told in lines]
    print(table(rows, ["record", "seconds", *(f"{title}, %" for title in TITLES.values())]))
    print(f"\n{wrapped(GONE_ON, '')}")
    if want:
        print(wrapped(_until(record, *want), ""))
    return 0


GONE_ON = (
    "Percentages are standard errors; those of the record are what it supports, the others follow by ratios of "
    "Cramér-Rao bounds. A longer record goes on at the same rate."
)


def _until(record: Taken, quantity: str, error: float) -> str:
    """What it takes to tell a quantity as well as is wanted."""
    title, factor = TITLES[quantity], record.factor_for(quantity, error)
    if factor == 1.0:
        return f"The record tells {title} to {percent(record.supported[quantity])} %, which is enough."
    number = record.number_for(quantity, error)
    again = f"{number} records like it do"
    if factor is None:
        return f"No longer record tells {title} to {100 * error:g} %: the motion has died away; {again}."
    seconds = (factor - 1.0) * record.duration
    now = percent(record.supported[quantity])
    return f"{seconds:.2g} s more bring {title} from {now} to {100 * error:g} %; {again} as well."
