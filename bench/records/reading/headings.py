"""A column and what its header says: a name, a unit, and what the two together say is measured."""

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
"""Endings that are a unit only where the name says as much: ``x_m``, but not ``ch_m``."""
WORD_ENDINGS = {"in", "min", "rev"}
"""Endings that are words as well, so that a letter is no name to rely on: ``position_in``, but not ``x_in``."""


@dataclass(frozen=True, eq=False)
class Column:
    """Numbers, NaN where one is missing, and their header as written with what it says.

    ``label`` is the unit as written ("" without one), ``unit`` the one it is known as, ``says`` what the name says is
    measured. ``times`` (s) are the column's own, where the file gives each column its clock; ``flaw`` says why the
    column cannot be taken ("" if it can). Of numbers in SI ``label`` is the SI unit, ``written`` that of the file.
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
        """Return what is measured, by the unit, unless the words of the name say something else."""
        return self.unit.measures if self.unit and self.says in (None, self.unit.measures) else None

    @property
    def named(self) -> Quantity | None:
        """Return what is measured, by the name alone: a word for it, or the letter of a role, maybe with a number."""
        match = re.fullmatch(r"([txvaf])\d*", self.name)
        if match and self.says is None:
            return LETTERS[match[1]]
        return None if self.says == "other" else self.says

    @property
    def number(self) -> tuple[str, int] | None:
        """Return the number that the name ends in, with what stands before it: ``("ch", 2)``."""
        match = re.fullmatch(r"(.*?)[ _.#-]*(\d{1,3})", self.name)
        return (match[1].lower(), int(match[2])) if match else None


def column_of(
    header: str, values: np.ndarray, label: str = "", says: Said = None, times: np.ndarray | None = None, flaw: str = ""
) -> Column:
    """Return the column under a header; what the file says of it elsewhere (``label``, ``says``) comes first."""
    header = " ".join(header.split())
    name, label = (header, label) if label else _name_and_label(header)
    says = says or _words(name)
    unit = unit_of(label.lower() if label in ("G", "mG") and says == "acceleration" else label)
    if label == "mg" and says != "acceleration":
        unit = None  # a mass as likely
    return Column(header, values, name, label, unit, says, times, flaw)


def _words(name: str) -> Said:
    """Return the one quantity that the words of a name speak of; None where there is none, or two."""
    words = re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)
    said = {WORDS[word.lower()] for word in words if word.lower() in WORDS}
    return said.pop() if len(said) == 1 else None


def _name_and_label(header: str) -> tuple[str, str]:
    """Return a header in two: name and unit, as in ``t [s]``, ``Force/N``, ``Angle, deg`` and ``time_ms``."""
    for match in reversed(list(re.finditer(r"\[([^\[\]]*)\]|\(((?:[^()]|\([^()]*\))*)\)", header))):
        label = (match[1] or match[2] or "").strip()
        if unit_of(label) or (match.end() == len(header) and label not in ("", "-")):
            return f"{header[: match.start()]} {header[match.end() :]}".strip(" /,_"), label
    for mark in re.finditer("(?!^)[/,]", header):
        if unit_of(header[mark.end() :]):
            return header[: mark.start()].strip(), header[mark.end() :].strip()
    return _by_underscores(header) or (header, "")


def _by_underscores(header: str) -> tuple[str, str] | None:
    """``v_m_s`` and ``v_m_per_s`` are in m/s, ``theta_rad_from_rest`` in rad; a short ending needs a name to fit."""
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
    """Return whether a label is a unit of what a name says, or may be where it says nothing."""
    letter = None if label in WORD_ENDINGS else FIRST_LETTERS.get(name[0].rstrip("0123456789"))
    unit, said = unit_of(label), _words("_".join(name)) or letter
    return unit is not None and (said == unit.measures or (said is None and not must_say))
