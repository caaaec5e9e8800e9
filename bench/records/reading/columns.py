"""Roles and units of columns: as specified by the user, or else from the units and names of the columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.errors import InputError
from bench.records.reading.headings import Column
from bench.records.reading.table import ReadOptions, Table, slot
from bench.records.reading.units import KNOWN, LETTERS, MEASURED_BY, unit_of

LETTER_OF: dict[str, str] = {quantity: letter for letter, quantity in LETTERS.items()}
EXAMPLES: dict[str, str] = {"t": "s", "x": "mm", "v": "m/s", "a": "g", "f": "N", "b": "g"}
"""Units suggested by errors."""


def columns_by_role(table: Table, options: ReadOptions, source: str) -> tuple[dict[str, Column], list[str]]:
    """Return the column of each role, in SI units except for times, and notes.

    Args:
        table: Columns of a file.
        options: Roles and units that the user specifies.
        source: Name of the file, for errors.

    Raises:
        InputError: A role or a unit is ambiguous; the message says what to add.
    """
    columns = Columns(table, options, source)
    roles, notes = (columns.named_roles(), []) if options.columns else columns.inferred_roles()
    columns.check_times(roles)
    columns.check_units(roles)
    taken = {role: columns.in_unit(role, i, notes) for role, i in roles.items()}
    known = {role: column for role, column in taken.items() if column is not None}
    if missing := [role for role in roles if role not in known]:
        which = ", ".join(f"{role} (column {columns.shown(roles[role])})" for role in missing)
        units = ",".join(f"{role}:{EXAMPLES[role[0]]}" for role in missing)
        raise columns.error(f"the unit of {which} is unknown; add units={units} with the actual units")
    if not options.columns:
        columns.check_motion(roles, known)
    return known, notes


@dataclass(frozen=True)
class Columns:
    """Columns of a table whose roles are to be determined; methods raise InputError for ambiguous ones."""

    table: Table
    options: ReadOptions
    source: str

    def __getitem__(self, i: int) -> Column:
        return self.table.columns[i]

    @property
    def usable(self) -> list[int]:
        """Indices of the columns without a flaw."""
        return [i for i, column in enumerate(self.table.columns) if not column.flaw]

    def others(self, time: int | None) -> list[int]:
        """Return the usable columns other than that of the time, of equal length."""
        sizes = {self[i].values.size for i in (self.usable if time is None else [time])}
        return [i for i in self.usable if i != time and self[i].values.size in sizes]

    def shown(self, i: int) -> str:
        """Return the display name of a column in errors, such as ``3 'X (mm)'``, or the name of a variable."""
        number = "" if self.table.contents else f"{i} "
        return f"{number}'{self[i].header}'" if self[i].header else f"{i}"

    def listed(self, numbers: Sequence[int]) -> str:
        return ", ".join(map(self.shown, numbers))

    def error(self, remedy: str, listing: bool = False) -> InputError:
        return InputError("data", self.source, f"{remedy}; it has {self.table.listing()}" if listing else remedy)

    def example(self, time: int | None = None, first: int | None = None, letter: str = "x") -> str:
        """Return an example of columns= with the time and another column."""
        others = self.others(time)
        value = first if first is not None else others[-1] if others else 0
        clock = next((i for i in (time, *others) if i is not None and i != value), None)
        text = f"{letter}:{self._key(value)}"
        if self.usable and all(self[i].times is not None for i in self.usable):
            return f"columns={text}"
        return f"columns={text} rate=… (Hz)" if clock is None else f"columns=t:{self._key(clock)},{text}"

    def _key(self, i: int) -> str:
        return self[i].header if self.table.contents and i < len(self.table.columns) else str(i)

    # roles specified by the user

    def named_roles(self) -> dict[str, int]:
        """Return the column of each role in columns=."""
        roles: dict[str, int] = {}
        for role, key in self.options.columns.items():
            i = self.number(role, key)
            flaw = self[i].flaw and f"cannot be used: {self[i].flaw}"
            if flaw or i in roles.values():
                remedy = f"column {self.shown(i)} {flaw or 'has two roles; use one'}"
                raise InputError("columns", f"{role}:{key}", remedy)
            roles[role] = i
        return roles

    def number(self, role: str, key: int | str) -> int:
        """Return the index of a column by its header, its name without the unit, or its number."""
        written = " ".join(str(key).split())
        headers = [i for i, column in enumerate(self.table.columns) if written == column.header]
        names = [i for i, column in enumerate(self.table.columns) if written.lower() == column.name.lower()]
        alike = [] if isinstance(key, int) else headers or names
        if len(alike) == 1:
            return alike[0]
        if not alike and written.isdigit() and int(written) < len(self.table.columns):
            return int(written)
        problem = "several columns have this name" if alike else "no such column"
        raise InputError("columns", f"{role}:{key}", f"{problem}; it has {self.table.listing()}")

    # roles inferred from units and names

    def inferred_roles(self) -> tuple[dict[str, int], list[str]]:
        """Return the columns whose unit or name determines their role, and a note on unused columns."""
        time = self._time()
        roles = {} if time is None else {"t": time}
        others = self.others(time)
        for letter in "xvaf":
            roles |= self._numbered(letter, self._group(letter, others), time)
        if all(role[0] in "tf" for role in roles):
            roles |= self._only_one([i for i in others if i not in roles.values()], time)
        left = [i for i, column in enumerate(self.table.columns) if i not in roles.values() and column.header]
        reasons = [f"{self.shown(i)} ({self[i].flaw or 'unknown unit'})" for i in left]
        return roles, [f"unused columns: {', '.join(reasons)}"] if left else []

    def _time(self) -> int | None:
        """Return the column of the time, by its unit, or by its name if it has no unit."""
        named = [i for i in self.usable if self[i].named == "time"]
        times = [i for i in self.usable if self[i].certain == "time" or (self[i].unit is None and i in named)]
        if len(times) > 1:
            times = [i for i in times if i in named] or times
        if len(times) > 1:
            which = f"several columns may be the time: {self.listed(times)}; add e.g. {self.example(times[0])}"
            raise self.error(which, listing=True)
        return times[0] if times else None

    def _group(self, letter: str, usable: Sequence[int]) -> list[int]:
        """Return the columns of a quantity, by their unit, or by their name if they have no unit.

        A name with an unknown unit, such as ``position [V]``, counts if units= specifies the unit.
        """
        sure = [i for i in usable if self[i].certain == LETTERS[letter]]
        by_name = [i for i in usable if self[i].unit is None and self[i].named == LETTERS[letter]]
        given = any(role[0] == letter for role in self.options.units)
        return sure + [i for i in by_name if not self[i].label] or (by_name if given else [])

    def _numbered(self, letter: str, group: Sequence[int], time: int | None) -> dict[str, int]:
        """Return the roles of a quantity: a letter, or numbered letters if headers are numbered (``x1``, ``ch2``)."""
        counted = {number: i for i in group if (number := self[i].number) is not None}
        before = {name for name, _ in counted}
        values = sorted(value for _, value in counted)
        by_letter = before == {letter} and values[0] > 0
        if len(group) < 2 and not by_letter:
            return dict.fromkeys(letter, group[0]) if group else {}
        from_first = by_letter or values == list(range(1, len(values) + 1))
        if len(counted) == len(group) and len(before) == 1 and from_first:
            return {f"{letter}{value}": i for (_, value), i in counted.items()}
        if self.options.sensors:
            return {f"{letter}{number}": i for number, i in enumerate(group, 1)}
        liveliest = max(group, key=lambda i: float(np.nanstd(self[i].values)) * (self[i].unit or (0, 1.0))[1])
        several = f"several columns measure {LETTERS[letter]}: {self.listed(group)}"
        dofs = f"{letter}1:{self._key(group[0])},{letter}2:{self._key(group[1])}"
        example = self.example(time, liveliest, letter)
        raise self.error(f"{several}; add e.g. {example}, or {dofs} for two DOFs")

    def _only_one(self, usable: Sequence[int], time: int | None) -> dict[str, int]:
        """Return the role of a single column if units= names just one role; otherwise raise InputError."""
        roles = [role for role in self.options.units if role != "t"]
        if len(usable) == 1 and self.options.sensors and not roles:
            return {"x": usable[0]}
        if len(usable) == 1 and len(roles) == 1 and not self[usable[0]].label:
            return {roles[0]: usable[0]}
        for i in usable:
            named = self[i].named
            if named and self[i].label and self[i].unit is None:
                letter = LETTER_OF[named]
                remedy = f"the unit of column {self.shown(i)} is unknown; add units={letter}:… ({KNOWN[named]})"
                raise self.error(f"{remedy}, or keep the unit with {self.example(time, i, letter)}")
        remedy = "a column of displacement, velocity or acceleration is needed"
        if usable:
            example = self.example(time)
            remedy = f"no column has a unit that determines its quantity; add e.g. {example} units=t:ms,x:mm"
        raise self.error(remedy, listing=True)

    # checks

    def check_times(self, roles: Mapping[str, int]) -> None:
        """Raise InputError for no signal, no times, two kinds of times, or unequal lengths."""
        signals = [i for role, i in roles.items() if role != "t"]
        if not signals:
            raise InputError("columns", "t", "a signal is needed in addition to the time; add x:…")
        clocks, rate = all(self[i].times is not None for i in signals), self.options.rate
        if rate is not None and ("t" in roles or clocks):
            clock = f"column {self.shown(roles['t'])}" if "t" in roles else "the file"
            raise InputError("rate", rate, f"{clock} contains the times; omit rate=, or t in columns=")
        if "t" not in roles and rate is None and not clocks:
            raise self.error("there are no times; add rate= (Hz), or t:… to columns=", listing=True)
        lengths = {role: self[i].values.size for role, i in roles.items()}
        if ("t" in roles or not clocks) and len(set(lengths.values())) > 1:
            shown = ", ".join(f"{role} has {n}" for role, n in lengths.items())
            raise self.error(f"columns of equal length are needed, but {shown}", listing=True)

    def check_units(self, roles: Mapping[str, int]) -> None:
        """Raise InputError for a unit of a role without a column."""
        taken = {slot(role) for role in roles}
        for role, unit in self.options.units.items():
            if slot(role) not in taken:
                remedy = f"no column has the role {role}; add e.g. {self.example(letter=role)}"
                remedy = "columns= does not contain this role" if self.options.columns else remedy
                raise InputError("units", f"{role}:{unit}", remedy)

    def in_unit(self, role: str, i: int, notes: list[str]) -> Column | None:
        """Return a column converted to SI from the unit in units= or else in the file; None without a known unit.

        A label that is not a known unit is kept only if columns= names the column. A note states differences between
        units= and the file.
        """
        column, quantity, given = self[i], {**LETTERS, **MEASURED_BY}[role[0]], self.options.unit(role)
        keeps = bool(self.options.columns or self.options.sensors) and quantity != "time"
        measures = column.unit.measures if column.unit else column.says
        if measures in LETTER_OF and measures != quantity:
            remedy = f"column {self.shown(i)} measures {measures}, not {quantity}; use the role {LETTER_OF[measures]}"
            raise InputError("columns", f"{role}:{i}", remedy)
        unit = unit_of(given) if given else column.unit
        if unit is not None and unit.measures != quantity:
            raise InputError("units", f"{role}:{given}", f"not a unit of {quantity}; supported: {KNOWN[quantity]}")
        if given and unit is None and not keeps:
            example = f"; to keep another unit name the column, e.g. {self.example(first=i, letter=role)}"
            remedy = f"unknown unit; supported: {KNOWN[quantity]}{'' if quantity == 'time' else example}"
            raise InputError("units", f"{role}:{given}", remedy)
        if given and column.label and (unit or given) != (column.unit or column.label):
            notes.append(f"{role}: unit {given} (from units=) replaces {column.label} (from the header)")
        label = given or column.label
        if unit is None:
            return replace(column, label=label, unit=None) if keeps and (label or self.options.sensors) else None
        size = 1.0 if quantity == "time" else unit.size
        return replace(column, values=column.values * size, unit=unit, label=unit.symbol, written=label)

    def check_motion(self, roles: Mapping[str, int], taken: Mapping[str, Column]) -> None:
        """Raise InputError for a DOF with both rotations and displacements."""
        first: dict[int, str] = {}
        for role in [role for role in taken if role[0] not in "tf"]:
            other = first.setdefault(slot(role)[1], role)
            if taken[other].label.startswith("rad") != taken[role].label.startswith("rad"):
                both = self.listed([roles[other], roles[role]])
                remedy = f"are a rotation and a displacement, which are not one DOF; add e.g. {self.example()}"
                raise self.error(f"columns {both} {remedy}")
