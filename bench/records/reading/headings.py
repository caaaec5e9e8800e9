"""Columns and the interpretation of their headers: name, unit and measured quantity."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

import numpy as np

from bench.records.reading.units import LETTERS, Quantity, Unit, unit_of

Said = Quantity | Literal["other"] | None
NAMES: dict[Quantity | Literal["other"], str] = {
    "time": "time times timestamp timestamps elapsed",
    "displacement": "displacement displacements disp position pos deflection angle theta phi elongation",
    "velocity": "velocity vel speed omega",
    "acceleration": "acceleration accel acc accelerometer",
    "force": "force torque load thrust",
    "other": "mass weight temperature temp voltage pressure frequency",
}
WORDS = {word: quantity for quantity, words in NAMES.items() for word in words.split()}
FIRST_LETTERS: dict[str, Quantity] = {**LETTERS, "y": "displacement", "z": "displacement", "F": "force"}
SHORT = {"s", "m", "g", "mg", "in", "min", "us", "rev", "N"}
"""Suffixes that are units only if the name agrees: ``x_m``, but not ``ch_m``."""
WORD_ENDINGS = {"in", "min", "rev"}
"""Suffixes that are also words, for which a letter is not sufficient as a name: ``position_in``, but not ``x_in``."""


@dataclass(frozen=True, eq=False)
class Column:
    """Column of a table.

    Attributes:
        header: Header in the file.
        values: Numbers, shape (n,), NaN if missing.
        name: Header without the unit.
        label: Unit in the header, "" without one; the SI unit after conversion.
        unit: The unit, None if unknown.
        says: Quantity according to the name.
        times: Times (s) of the column, for formats in which each column has its own.
        flaw: Reason for which the column cannot be used, "" if it can.
        written: Unit in the file, after conversion to SI.
    """

    header: str
    values: np.ndarray
    name: str
    label: str
    unit: Unit | None
    says: Said
    times: np.ndarray | None
    flaw: str
    written: str = ""

    @property
    def certain(self) -> Quantity | None:
        """Quantity according to the unit; None if the name contradicts it."""
        return self.unit.measures if self.unit and self.says in (None, self.unit.measures) else None

    @property
    def named(self) -> Quantity | None:
        """Quantity according to the name: a word, or the letter of a role with an optional number."""
        match = re.fullmatch(r"([txvaf])\d*", self.name)
        if match and self.says is None:
            return LETTERS[match[1]]
        return None if self.says == "other" else self.says

    @property
    def number(self) -> tuple[str, int] | None:
        """Prefix and number of a numbered name, such as ``("ch", 2)``."""
        match = re.fullmatch(r"(.*?)[ _.#-]*(\d{1,3})", self.name)
        return (match[1].lower(), int(match[2])) if match else None


def column_of(
    header: str, values: np.ndarray, label: str = "", says: Said = None, times: np.ndarray | None = None, flaw: str = ""
) -> Column:
    """Return the column of a header.

    Args:
        header: Header in the file.
        values: Numbers, shape (n,).
        label: Unit, if the file states it outside of the header.
        says: Quantity, if the file states it.
        times: Times of the column (s).
        flaw: Reason for which the column cannot be used.
    """
    header = " ".join(header.split())
    name, label = (header, label) if label else _name_and_label(header)
    says = says or _words(name)
    unit = unit_of(label.lower() if label in ("G", "mG") and says == "acceleration" else label)
    if label == "mg" and says != "acceleration":
        unit = None  # it may be a mass
    return Column(header, values, name, label, unit, says, times, flaw)


def _words(name: str) -> Said:
    """Return the quantity that a name contains; None for no or several quantities."""
    words = re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)
    quantities = {WORDS[word.lower()] for word in words if word.lower() in WORDS}
    return quantities.pop() if len(quantities) == 1 else None


def _name_and_label(header: str) -> tuple[str, str]:
    """Split a header into name and unit: ``t [s]``, ``Force/N``, ``Angle, deg``, ``time_ms``."""
    for match in reversed(list(re.finditer(r"\[([^\[\]]*)\]|\(((?:[^()]|\([^()]*\))*)\)", header))):
        label = (match[1] or match[2] or "").strip()
        if unit_of(label) or (match.end() == len(header) and label not in ("", "-")):
            return f"{header[: match.start()]} {header[match.end() :]}".strip(" /,_"), label
    for mark in re.finditer("(?!^)[/,]", header):
        if unit_of(header[mark.end() :]):
            return header[: mark.start()].strip(), header[mark.end() :].strip()
    return _by_underscores(header) or (header, "")


def _by_underscores(header: str) -> tuple[str, str] | None:
    """Split a header at underscores: ``v_m_s`` and ``v_m_per_s`` are in m/s, ``theta_rad_from_rest`` in rad."""
    parts = header.replace("_per_", "_").split("_")
    last = len(parts) - 1
    if last > 1 and _fits(parts[:1], label := f"{parts[-2]}/{parts[-1]}", False):
        return "_".join(parts[:-2]), label
    if last > 0 and _fits(parts[:-1], parts[-1], parts[-1] in SHORT):
        return "_".join(parts[:-1]), parts[-1]
    inner = [i for i in range(1, last) if parts[i] not in SHORT and _fits(parts[:i], parts[i], True)]
    if len(inner) == 1 and not unit_of(parts[-1]):
        return "_".join(parts[: inner[0]] + parts[inner[0] + 1 :]), parts[inner[0]]
    return None


def _fits(name: list[str], label: str, must_say: bool) -> bool:
    """Return whether a label is a unit of the quantity in a name; ``must_say``: whether the name must have one."""
    letter = None if label in WORD_ENDINGS else FIRST_LETTERS.get(name[0].rstrip("0123456789"))
    unit, quantity = unit_of(label), _words("_".join(name)) or letter
    return unit is not None and (quantity == unit.measures or (quantity is None and not must_say))
