"""Which column has which role and unit: as the user says, or else as the units and names of the columns say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bench.errors import InputError
from bench.records.reading.headings import Heading, heading_of
from bench.records.reading.options import LETTERS, ReadOptions, slot
from bench.records.reading.table import Column, Table
from bench.records.reading.units import KNOWN, unit_of

LETTER_OF: dict[str, str] = {quantity: letter for letter, quantity in LETTERS.items()}
EXAMPLES: dict[str, str] = {"t": "s", "x": "mm", "v": "m/s", "a": "g", "f": "N"}
"""Units that an error suggests."""


def columns_by_role(table: Table, options: ReadOptions, source: str) -> tuple[dict[str, Column], list[str]]:
    """Return the column of each role, in SI but for the times, and notes of what was left out or differs.

    Raises:
        InputError: a role or a unit is not certain; it says what to add.
    """
    columns = _Columns(table, options, source)
    roles, notes = (columns.named_roles(), []) if options.columns else columns.found_roles()
    columns.check_times(roles)
    columns.check_units(roles)
    taken = {role: columns.in_unit(role, i, notes) for role, i in roles.items()}
    known = {role: column for role, column in taken.items() if column is not None}
    if missing := [role for role in roles if role not in known]:
        which = ", ".join(f"{role} (column {columns.shown(roles[role])})" for role in missing)
        units = ",".join(f"{role}:{EXAMPLES[role[0]]}" for role in missing)
        raise columns.error(f"no unit is known of {which}; add units={units} with what they are in")
    if not options.columns:
        columns.check_motion(roles, known)
    return known, notes


@dataclass(frozen=True)
class _Columns:
    """The columns of a table, of which roles are to be found; InputError is raised where one is not certain."""

    table: Table
    options: ReadOptions
    source: str

    @cached_property
    def headings(self) -> list[Heading]:
        return [heading_of(column) for column in self.table.columns]

    @cached_property
    def usable(self) -> list[int]:
        """Numbers of the columns that can be taken."""
        return [i for i, column in enumerate(self.table.columns) if not column.flaw]

    def beside(self, time: int | None) -> list[int]:
        """Return the usable columns other than the time's, of its length."""
        size = {len(self[time].values)} if time is not None else {len(self[i].values) for i in self.usable}
        return [i for i in self.usable if i != time and len(self[i].values) in size]

    def __getitem__(self, i: int) -> Column:
        return self.table.columns[i]

    def have_clocks(self, numbers: Sequence[int]) -> bool:
        """Return whether the file gives each of these columns its own times."""
        return all(self[i].times is not None for i in numbers)

    def shown(self, i: int) -> str:
        """Return a column as an error names it: ``3 'X (mm)'``, or the name of a variable."""
        text = self.headings[i].text
        return f"'{text}'" if self.table.contents else f"{i} '{text}'" if text else f"{i}"

    def listed(self, numbers: Sequence[int]) -> str:
        return ", ".join(self.shown(i) for i in numbers)

    def error(self, remedy: str) -> InputError:
        return InputError("data", self.source, remedy)

    def example(self, time: int | None = None, first: int | None = None, letter: str = "x") -> str:
        """Return the remedy that always helps: columns= with a time and one other column, as the user may write it."""
        others = self.beside(time)
        value = first if first is not None else others[-1] if others else 0
        clock = next((i for i in (time, *others) if i is not None and i != value), None)
        text = f"{letter}:{self._key(value)}"
        if self.usable and self.have_clocks(self.usable):
            return f"columns={text}"
        return f"columns={text} rate=… (Hz)" if clock is None else f"columns=t:{self._key(clock)},{text}"

    def _key(self, i: int) -> str:
        return self[i].name if self.table.contents and i < len(self.table.columns) else str(i)

    # roles that the user names

    def named_roles(self) -> dict[str, int]:
        """Return the number of the column that columns= names for each role."""
        roles: dict[str, int] = {}
        for role, key in self.options.columns.items():
            i = self._number(role, key)
            flaw = self[i].flaw and f"cannot be taken: {self[i].flaw}"
            if flaw or i in roles.values():
                remedy = f"column {self.shown(i)} {flaw or 'has another role; give one to each'}"
                raise InputError("columns", f"{role}:{key}", remedy)
            roles[role] = i
        return roles

    def _number(self, role: str, key: int | str) -> int:
        problem = "no such column"
        if isinstance(key, str):
            written = key.strip()
            for names in (
                [key == column.name for column in self.table.columns],
                [written == heading.text for heading in self.headings],
                [written.lower() == heading.name.lower() for heading in self.headings],
            ):
                if sum(names) == 1:
                    return names.index(True)
                if any(names):
                    problem = "several columns have this name"
                    break
        digits = isinstance(key, int) or (key.strip().isdigit() and problem == "no such column")
        if digits and 0 <= int(key) < len(self.table.columns):
            return int(key)
        raise InputError("columns", f"{role}:{key}", f"{problem}; it has {self.table.listing()}")

    # roles that units and names give

    def found_roles(self) -> tuple[dict[str, int], list[str]]:
        """Return the columns whose unit or name says what they measure, and a note of those that are left out."""
        time = self._time()
        roles = {} if time is None else {"t": time}
        others = self.beside(time)
        for letter in "xvaf":
            roles |= self._numbered(letter, self._group(letter, others), time)
        if all(role[0] in "tf" for role in roles):
            roles |= self._only_one([i for i in others if i not in roles.values()], time)
        left = [i for i, column in enumerate(self.table.columns) if i not in roles.values() and column.name]
        reasons = [f"{self.shown(i)} ({self[i].flaw or 'it has no known unit'})" for i in left]
        return roles, [f"columns left out: {', '.join(reasons)}"] if left else []

    def _time(self) -> int | None:
        """Return the column of the time: by its unit, or by its name where it has no unit."""
        heads = {i: self.headings[i] for i in self.usable}
        found = [i for i, h in heads.items() if h.certain == "time" or (h.unit is None and h.named == "time")]
        if len(found) > 1:
            found = [i for i in found if heads[i].named == "time"] or found
        if len(found) > 1:
            which = f"which column is the time, {self.listed(found)}? Add e.g. {self.example(found[0])}"
            raise self.error(f"{which}; it has {self.table.listing()}")
        return found[0] if found else None

    def _group(self, letter: str, usable: Sequence[int]) -> list[int]:
        """Return the columns of one quantity: by their unit, or by their name where no unit stands with it.

        A name with a label that is no unit, such as ``position [V]``, counts where units= says what it is in.
        """
        heads = {i: self.headings[i] for i in usable}
        sure = [i for i, h in heads.items() if h.certain == LETTERS[letter]]
        by_name = [i for i, h in heads.items() if h.unit is None and h.named == LETTERS[letter]]
        given = any(role[0] == letter for role in self.options.units)
        return sure + [i for i in by_name if not heads[i].label] or (by_name if given else [])

    def _numbered(self, letter: str, group: Sequence[int], time: int | None) -> dict[str, int]:
        """Return roles of one quantity: the plain letter, or numbers where headers count ``x1, x2`` or ``ch1, ch2``."""
        counted = {i: number for i in group if (number := self.headings[i].number) is not None}
        before = {name for name, _ in counted.values()}
        values = sorted(value for _, value in counted.values())
        by_letter = before == {letter} and values[0] > 0
        if len(group) < 2 and not by_letter:
            return dict.fromkeys(letter, group[0]) if group else {}
        alike = len(counted) == len(group) and len(before) == 1 and len(set(values)) == len(values)
        if alike and (by_letter or values == list(range(1, len(values) + 1))):
            return {f"{letter}{value}": i for i, (_, value) in counted.items()}
        liveliest = max(group, key=lambda i: float(np.nanstd(self[i].values) * self._size(i)))
        several = f"several columns measure {LETTERS[letter]}: {self.listed(group)}"
        dofs = f"{letter}1:{self._key(group[0])},{letter}2:{self._key(group[1])}"
        example = self.example(time, liveliest, letter)
        raise self.error(f"{several}; add e.g. {example}, or {dofs} where they are two DOFs")

    def _size(self, i: int) -> float:
        unit = self.headings[i].unit
        return 1.0 if unit is None else unit.size

    def _only_one(self, usable: Sequence[int], time: int | None) -> dict[str, int]:
        """Return the single column there is, where units= names the one role it can have."""
        asked = [role for role in self.options.units if role != "t"]
        if len(usable) == 1 and len(asked) == 1 and not self.headings[usable[0]].label:
            return {asked[0]: usable[0]}
        for i in usable:
            heading = self.headings[i]
            if heading.unit is None and heading.label and heading.named:
                letter = LETTER_OF[heading.named]
                remedy = f"column {self.shown(i)} is in no known unit; add units={letter}:… ({KNOWN[heading.named]})"
                raise self.error(f"{remedy}, or keep it as it is with {self.example(time, i, letter)}")
        remedy = "a column of displacement, velocity or acceleration is needed"
        if usable:
            example = self.example(time)
            remedy = f"no unit says what a column measures; add e.g. {example}, and units= where the file has none"
        raise self.error(f"{remedy}; it has {self.table.listing()}")

    # what must hold of the roles

    def check_times(self, roles: Mapping[str, int]) -> None:
        """Refuse a choice with no signal, without times or with two kinds of them, or of unequal lengths."""
        signals = [i for role, i in roles.items() if role != "t"]
        if not signals:
            raise InputError("columns", "t", "a column that measures something is needed beside the time; add x:…")
        own, rate = self.have_clocks(signals), self.options.rate
        if rate is not None and ("t" in roles or own):
            what = f"column {self.shown(roles['t'])}" if "t" in roles else "the file"
            raise InputError("rate", rate, f"{what} gives the times; leave out rate=, or t in columns=")
        if "t" not in roles and rate is None and not own:
            listing = self.table.listing()
            raise self.error(f"nothing gives the times; add rate= (Hz), or t:… to columns=; it has {listing}")
        lengths = {role: self[i].values.size for role, i in roles.items()}
        if ("t" in roles or not own) and len(set(lengths.values())) > 1:
            shown = ", ".join(f"{role} has {n}" for role, n in lengths.items())
            raise self.error(f"columns of one length are needed, but {shown}; it has {self.table.listing()}")

    def check_units(self, roles: Mapping[str, int]) -> None:
        """Refuse a unit of a role that no column has."""
        taken = {slot(role) for role in roles}
        for role, unit in self.options.units.items():
            if slot(role) not in taken:
                remedy = f"no column is known to be {role}; add e.g. {self.example(letter=role)}"
                remedy = "columns= does not name it" if self.options.columns else remedy
                raise InputError("units", f"{role}:{unit}", remedy)

    def in_unit(self, role: str, i: int, notes: list[str]) -> Column | None:
        """Return a column in the unit that units= or else the file says, None without a unit; note where they differ.

        A label that is no known unit is kept only where columns= names the column.
        """
        column, heading, quantity, given = self[i], self.headings[i], LETTERS[role[0]], self.options.unit(role)
        keeps = bool(self.options.columns) and quantity != "time"
        said = heading.unit.measures if heading.unit else heading.says
        if said in LETTER_OF and said != quantity:
            remedy = f"column {self.shown(i)} measures {said}, not {quantity}; take it as {LETTER_OF[said]}"
            raise InputError("columns", f"{role}:{i}", remedy)
        unit = unit_of(given) if given else heading.unit
        if unit is not None and unit.measures != quantity:
            raise InputError("units", f"{role}:{given}", f"it is no unit of {quantity}; known are {KNOWN[quantity]}")
        if given and unit is None and not keeps:
            example = f"; to keep another name the column, e.g. {self.example(first=i, letter=role)}"
            remedy = f"known are {KNOWN[quantity]}{'' if quantity == 'time' else example}"
            raise InputError("units", f"{role}:{given}", remedy)
        if given and heading.label and (unit or given) != (heading.unit or heading.label):
            notes.append(f"{role} is taken in {given}, as units= says; its header says {heading.label}")
        label = given or heading.label
        if unit is None:
            return replace(column, unit=label) if label and keeps else None
        if quantity == "time":
            return replace(column, unit=label)
        return replace(column, values=column.values * unit.size, unit=unit.symbol)

    def check_motion(self, roles: Mapping[str, int], taken: Mapping[str, Column]) -> None:
        """Refuse a DOF that both turns and moves along, unless the user names the columns."""
        first: dict[int, str] = {}
        for role, column in taken.items():
            if role[0] in "tf":
                continue
            other = first.setdefault(slot(role)[1], role)
            if taken[other].unit.startswith("rad") != column.unit.startswith("rad"):
                both = self.listed([roles[other], roles[role]])
                remedy = f"turn and move along, so they are not of one DOF; add e.g. {self.example()}"
                raise self.error(f"columns {both} {remedy}")
