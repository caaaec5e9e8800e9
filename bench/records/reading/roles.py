"""Which column has which role: as the user names them, or else as their units and names say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from bench.errors import InputError
from bench.records.reading.columns import Columns
from bench.records.reading.headings import ROLE_LETTERS, is_trial
from bench.records.reading.options import ReadOptions
from bench.records.reading.units import KNOWN, Measures

MEASURES: tuple[Measures, ...] = ("displacement", "velocity", "acceleration", "force")
LETTER_OF: dict[str, str] = {quantity: letter for letter, quantity in ROLE_LETTERS.items()}


def named_roles(columns: Columns, wanted: Mapping[str, int | str]) -> dict[str, int]:
    """The number of the column that the user names for each role; raises InputError."""
    roles: dict[str, int] = {}
    for role, key in wanted.items():
        i = _find(columns, role, key)
        if columns[i].flaw:
            raise InputError(
                "columns", f"{role}:{key}", f"column {columns.shown(i)} cannot be taken: {columns[i].flaw}"
            )
        if i in roles.values():
            raise InputError(
                "columns", f"{role}:{key}", f"column {columns.shown(i)} has another role; give one to each"
            )
        roles[role] = i
    return roles


def _find(columns: Columns, role: str, key: int | str) -> int:
    if isinstance(key, str):
        written = key.strip()
        ways = (
            [i for i, column in enumerate(columns.table.columns) if column.name == key],
            [i for i, heading in enumerate(columns.headings) if heading.text == written],
            [i for i, heading in enumerate(columns.headings) if heading.name.lower() == written.lower()],
        )
        found = next((way for way in ways if way), [])
        if len(found) == 1:
            return found[0]
        if found or not written.isdigit():
            how = "several columns have this name" if found else "no such column"
            raise InputError("columns", f"{role}:{key}", f"{how}; it has {columns.table.listing()}")
    number = int(key)
    if not 0 <= number < len(columns.table.columns):
        raise InputError("columns", f"{role}:{key}", f"no such column; it has {columns.table.listing()}")
    return number


def found_roles(columns: Columns, options: ReadOptions) -> tuple[dict[str, int], list[str]]:
    """Roles of the columns whose unit or name says what they measure, and a note of those that are left out.

    Raises:
        InputError: a role could be that of several columns, or no column has one.
    """
    _check_trials(columns)
    time = _time(columns)
    roles = {} if time is None else {"t": time}
    usable = [
        i for i in columns.usable if i != time and (time is None or columns[i].values.size == columns[time].values.size)
    ]
    for measures in MEASURES:
        roles |= _numbered(columns, measures, _group(columns, options, measures, usable), time)
    if all(role[0] in "tf" for role in roles):
        roles |= _only_one(columns, options, [i for i in usable if i not in roles.values()], time)
    left = [i for i, column in enumerate(columns.table.columns) if i not in roles.values() and column.name]
    reasons = [f"{columns.shown(i)} ({columns[i].flaw or 'it has no known unit'})" for i in left]
    return roles, [f"columns left out: {', '.join(reasons)}"] if left else []


def _check_trials(columns: Columns) -> None:
    for i in columns.usable:
        if is_trial(columns[i].name) and np.unique(columns[i].values).size > 1:
            remedy = f"column {columns.shown(i)} counts several records; keep one of them in a file of its own"
            raise columns.error(f"{remedy}, or name its columns, e.g. {columns.example()}")


def _time(columns: Columns) -> int | None:
    """The column of the time, by its unit, or by its name where it has no unit."""
    found = [
        i
        for i in columns.usable
        if columns.headings[i].certain == "time"
        or (columns.headings[i].unit is None and columns.headings[i].named == "time")
    ]
    if len(found) > 1:
        found = [i for i in found if columns.headings[i].named == "time"] or found
    if len(found) > 1:
        which = f"which column is the time, {columns.listed(found)}? Add e.g. {columns.example(found[0])}"
        raise columns.error(f"{which}; it has {columns.table.listing()}")
    return found[0] if found else None


def _group(columns: Columns, options: ReadOptions, measures: Measures, usable: Sequence[int]) -> list[int]:
    """The columns of one quantity: by their unit, or by their name where no unit stands with it.

    A name with a label that is no unit, such as ``position [V]``, counts where units= says what it is in.
    """
    sure = [i for i in usable if columns.headings[i].certain == measures]
    by_name = [i for i in usable if columns.headings[i].unit is None and columns.headings[i].named == measures]
    bare = [i for i in by_name if not columns.headings[i].label]
    given = any(role[0] == LETTER_OF[measures] for role in options.units)
    return sure + bare or (by_name if given else [])


def _numbered(columns: Columns, measures: Measures, group: Sequence[int], time: int | None) -> dict[str, int]:
    """Roles of one quantity: the plain letter, or numbers where the headers count ``x1, x2`` or ``ch1, ch2``."""
    letter = LETTER_OF[measures]
    counted = {i: number for i in group if (number := columns.headings[i].number) is not None}
    before = {name for name, _ in counted.values()}
    values = sorted(value for _, value in counted.values())
    own = before == {letter}
    if len(group) == 1 and not (own and values[0] > 0):
        return {letter: group[0]}
    one_each = len(counted) == len(group) and len(before) < 2 and len(set(values)) == len(values)
    if not one_each or not (values == list(range(1, len(values) + 1)) or (own and values[0] > 0)):
        several = f"several columns measure {measures}: {columns.listed(group)}"
        dofs = f"{letter}1:{group[0]},{letter}2:{group[1]}"
        raise columns.error(
            f"{several}; add e.g. {columns.example(time, group[0], letter)}, or {dofs} where they are two DOFs"
        )
    return {f"{letter}{value}": i for i, (_, value) in counted.items()}


def _only_one(columns: Columns, options: ReadOptions, usable: Sequence[int], time: int | None) -> dict[str, int]:
    """The single column there is, where units= names the one role it can have; raises InputError otherwise."""
    asked = [role for role in options.units if role != "t"]
    if len(usable) == 1 and len(asked) == 1 and not columns.headings[usable[0]].label:
        return {asked[0]: usable[0]}
    for i in usable:
        heading = columns.headings[i]
        if heading.unit is None and heading.label and heading.named:
            letter, known = LETTER_OF[heading.named], KNOWN[heading.named]
            keep = columns.example(time, i, letter)
            remedy = f"column {columns.shown(i)} is in no known unit; add units={letter}:… ({known})"
            raise columns.error(f"{remedy}, or keep it as it is with {keep}")
    if not usable:
        raise columns.error(
            f"a column of displacement, velocity or acceleration is needed; it has {columns.table.listing()}"
        )
    remedy = (
        f"no unit says what a column measures; add e.g. {columns.example(time)}, and units= where the file has none"
    )
    raise columns.error(f"{remedy}; it has {columns.table.listing()}")
