"""What settings do together: the errors of all their combinations, on the same data sets."""

from __future__ import annotations

from itertools import product

from bench.reporting.family import Family, Member
from bench.reporting.tables.family_numbers import GROUP, MISSING, OTHER, PLACE, accuracy, median, text
from bench.reporting.tables.render import Rows, markdown_table

Combination = tuple[object, ...]
"""A value of each setting."""


def combinations(family: Family) -> list[str]:
    """Heading, explanation and table; nothing where no settings were combined."""
    if len(family.combinations.settings) < 2 or not family.combinations.rows:
        return []
    found = _members(family)
    n = min((one.n for member in found.values() if (one := member.at(PLACE))), default=0)
    words = [setting.replace("_", " ") for setting in family.combinations.settings]
    explanation = (
        f"Errors of k/m and c/m over the bound on the first {n} data sets ({PLACE[0]:g} dB, start {PLACE[1]}), and "
        "processor seconds of a whole fit."
    )
    return [f"## All combinations of {', '.join(words)}", explanation, markdown_table(*_table(family, found, n))]


def _members(family: Family) -> dict[Combination, Member]:
    """Every member that differs from the defaults in the combined settings alone, by their values."""
    settings, usual = family.combinations.settings, family.names.usual
    own = [one for one in family.members if one.method == family.method and set(one.settings) <= set(settings)]
    return {tuple(member.settings.get(name, usual[name]) for name in settings): member for member in own}


def _values(family: Family, setting: str) -> list[object]:
    """The values of a setting that were combined, in the order of the card."""
    usual = family.names.usual[setting]
    found = {row.member.settings.get(setting, usual) for row in family.combinations.rows}
    return sorted(found, key=lambda value: family.names.order(setting, value))


def _table(family: Family, found: dict[Combination, Member], n: int) -> Rows:
    """A line a value of all settings but the second, whose values stand side by side."""
    names, (first, second, *others) = family.names, family.combinations.settings
    down, across = (first, *others), _values(family, second)
    rows = []
    for line in product(*(_values(family, setting) for setting in down)):
        named = [names.of(setting, value) for setting, value in zip(down, line, strict=True)]
        rows.append([*named, *(_entry(found.get((line[0], value, *line[1:])), n) for value in across)])
    headers = [setting.replace("_", " ") for setting in down]
    return rows, [*headers, *(names.of(second, value) for value in across)]


def _entry(member: Member | None, n: int) -> str:
    """Both errors and the time; what is missing is said."""
    one = member.at(PLACE) if member else None
    if one is None:
        return MISSING
    values = accuracy(one, n)
    both = ", ".join(text(f"{group}_excess", values[f"{group}_excess"]) for group in (GROUP, OTHER))
    return f"{both} ({text('fit_s', median(one.cpu_s))} s)"
