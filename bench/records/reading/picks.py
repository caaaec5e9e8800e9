"""The columns that are taken, each with its role and its size in SI."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from bench.errors import InputError
from bench.records.reading.columns import Columns
from bench.records.reading.headings import ROLE_LETTERS
from bench.records.reading.options import ReadOptions, slot
from bench.records.reading.roles import LETTER_OF, found_roles, named_roles
from bench.records.reading.table import Column, Table
from bench.records.reading.units import KNOWN, Quantity, unit_of

EXAMPLES: dict[Quantity, str] = {
    "time": "s", "displacement": "mm", "velocity": "m/s", "acceleration": "g", "force": "N",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Pick:
    """A column taken for a role; its values times ``size`` are in ``unit``."""

    role: str
    column: Column
    size: float
    unit: str

    @property
    def quantity(self) -> Quantity:
        return ROLE_LETTERS[self.role[0]]

    @property
    def dof(self) -> int:
        """From 0; x and x1 are the first."""
        return slot(self.role)[1]


def pick(table: Table, options: ReadOptions, source: object) -> tuple[dict[str, Pick], list[str]]:
    """The column of each role, and notes of what was left out or taken otherwise than the header says.

    Raises:
        InputError: a role or a unit is not certain; it says what to add.
    """
    columns = Columns(table, source)
    named = bool(options.columns)
    roles, notes = (named_roles(columns, options.columns), []) if named else found_roles(columns, options)
    _check_clock(columns, roles, options)
    taken = {slot(role) for role in roles}
    for role, unit in options.units.items():
        if slot(role) not in taken:
            remedy = (
                "columns= does not name it"
                if named
                else f"no column is known to be {role}; add e.g. {columns.example(letter=role)}"
            )
            raise InputError("units", f"{role}:{unit}", remedy)
    picks, missing = {}, []
    for role, i in roles.items():
        found, said = _pick(columns, role, i, options.unit(role), named)
        notes += said
        if found is None:
            missing.append(role)
        else:
            picks[role] = found
    if missing:
        which = ", ".join(f"{role} (column {columns.shown(roles[role])})" for role in missing)
        units = ",".join(f"{role}:{EXAMPLES[ROLE_LETTERS[role[0]]]}" for role in missing)
        raise columns.error(f"no unit is known of {which}; add units={units} with what they are in")
    if not named:
        _check_motion(columns, roles, picks)
    return picks, notes


def _check_clock(columns: Columns, roles: Mapping[str, int], options: ReadOptions) -> None:
    """Refuse a choice with no signal, without times or with two kinds of them, or of unequal lengths."""
    signals = [i for role, i in roles.items() if role != "t"]
    if not signals:
        raise InputError("columns", "t", "a column that measures something is needed beside the time; add x:…")
    own = columns.have_clocks(signals)
    if options.rate is not None and ("t" in roles or own):
        what = f"column {columns.shown(roles['t'])}" if "t" in roles else "the file"
        raise InputError("rate", options.rate, f"{what} gives the times; leave out rate=, or t in columns=")
    if "t" not in roles and options.rate is None and not own:
        there = columns.table.listing()
        raise columns.error(f"nothing gives the times; add rate= (Hz), or t:… to columns=; it has {there}")
    lengths = {role: columns[i].values.size for role, i in roles.items()}
    if ("t" in roles or not own) and len(set(lengths.values())) > 1:
        shown = ", ".join(f"{role} has {n}" for role, n in lengths.items())
        raise columns.error(f"columns of one length are needed, but {shown}; it has {columns.table.listing()}")


def _pick(columns: Columns, role: str, i: int, given: str, named: bool) -> tuple[Pick | None, list[str]]:
    """A column in the unit that units= or else the file says, and a note where they differ; None without a unit.

    A label that is no known unit is kept only where columns= names the column.
    """
    heading, quantity = columns.headings[i], ROLE_LETTERS[role[0]]
    said = heading.unit.measures if heading.unit else heading.says
    if said in LETTER_OF and said != quantity:
        remedy = f"column {columns.shown(i)} measures {said}, not {quantity}; take it as {LETTER_OF[said]}"
        raise InputError("columns", f"{role}:{i}", remedy)
    unit = unit_of(given) if given else heading.unit
    if unit is not None and unit.measures != quantity:
        raise InputError("units", f"{role}:{given}", f"it is no unit of {quantity}; known are {KNOWN[quantity]}")
    if given and unit is None and (quantity == "time" or not named):
        keep = (
            ""
            if quantity == "time"
            else f"; to keep another name the column, e.g. {columns.example(first=i, letter=role)}"
        )
        raise InputError("units", f"{role}:{given}", f"known are {KNOWN[quantity]}{keep}")
    differ = given and heading.label and (unit or given) != (heading.unit or heading.label)
    notes = [f"{role} is taken in {given}, as units= says; its header says {heading.label}"] if differ else []
    if unit is not None:
        return Pick(role, columns[i], unit.size, unit.symbol), notes
    label = given or heading.label
    return (Pick(role, columns[i], 1.0, label) if label and named and quantity != "time" else None), notes


def _check_motion(columns: Columns, roles: Mapping[str, int], picks: Mapping[str, Pick]) -> None:
    """Refuse a DOF that both turns and moves along, unless the user says so."""
    first: dict[int, Pick] = {}
    for role, found in picks.items():
        if found.quantity in ("time", "force"):
            continue
        other = first.setdefault(found.dof, found)
        if other.unit.startswith("rad") != found.unit.startswith("rad"):
            both = columns.listed([roles[other.role], roles[role]])
            raise columns.error(
                f"columns {both} turn and move along, so they are not of one DOF; add e.g. {columns.example()}"
            )
