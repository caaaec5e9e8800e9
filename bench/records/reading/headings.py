"""What the header of a column says: a name, a unit, and what the two together say is measured."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

from bench.records.reading.options import LETTERS
from bench.records.reading.table import Column
from bench.records.reading.units import Quantity, Unit, unit_of

NAMES: dict[Quantity | Literal["other"], str] = {
    "time": "time times timestamp timestamps elapsed",
    "displacement": "displacement displacements disp position pos deflection angle theta phi elongation",
    "velocity": "velocity vel speed omega",
    "acceleration": "acceleration accel acc accelerometer",
    "force": "force torque load thrust",
    "other": "mass weight temperature temp voltage pressure frequency",
}
WORDS = {word: quantity for quantity, words in NAMES.items() for word in words.split()}
TRIALS = {"trial", "trials", "run", "experiment", "test"}
FIRST_LETTERS: dict[str, Quantity] = {**LETTERS, "y": "displacement", "z": "displacement", "F": "force"}
SHORT = {"s", "m", "g", "mg", "in", "min", "us", "rev", "N"}
"""Endings that are a unit only where the name says as much: ``x_m``, but not ``ch_m``."""
WORD_ENDINGS = {"in", "min", "rev"}
"""Endings that are words as well, so that a letter is no name to rely on: ``position_in``, but not ``x_in``."""


@dataclass(frozen=True)
class Heading:
    """A column's header as written, its name, its unit as written ("" without one) and, where known, as a unit."""

    text: str
    name: str
    label: str
    unit: Unit | None
    says: Quantity | Literal["other"] | None

    @property
    def certain(self) -> Quantity | None:
        """Return what is measured, by the unit, unless the words of the name say something else."""
        if self.unit is None or self.says not in (None, self.unit.measures):
            return None
        return self.unit.measures

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


def heading_of(column: Column) -> Heading:
    """Read a column's header; a unit that the file keeps elsewhere comes before one in the header."""
    text = " ".join(column.name.split())
    name, label = (text, column.unit) if column.unit else _name_and_label(text)
    says = column.measures or _words(name)
    unit = unit_of(label) if label else None
    if unit is None and label in ("G", "mG") and says == "acceleration":
        unit = unit_of(label.lower())
    if label == "mg" and says != "acceleration":
        unit = None  # a mass as likely
    return Heading(text, name, label, unit, says)


def is_trial(name: str) -> bool:
    """Return whether a column of this name counts the runs in a file."""
    return name.strip().lower() in TRIALS


def _words(name: str) -> Quantity | Literal["other"] | None:
    """Return the one quantity that the words of a name speak of; None where there is none, or two."""
    words = re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)
    found = {WORDS[word.lower()] for word in words if word.lower() in WORDS}
    return found.pop() if len(found) == 1 else None


def _name_and_label(text: str) -> tuple[str, str]:
    """Return a header in two: name and unit, as in ``t [s]``, ``Force/N``, ``Angle, deg`` and ``time_ms``."""
    for split in (_bracketed, _after_mark, _after_underscore):
        if parts := split(text):
            return parts
    return text, ""


def _bracketed(text: str) -> tuple[str, str] | None:
    brackets = list(re.finditer(r"\[([^\[\]]*)\]|\(((?:[^()]|\([^()]*\))*)\)", text))
    for match in reversed(brackets):
        label = (match[1] or match[2] or "").strip()
        if unit_of(label) or (match.end() == len(text) and label not in ("", "-")):
            return f"{text[: match.start()]} {text[match.end() :]}".strip(" /,_"), label
    return None


def _after_mark(text: str) -> tuple[str, str] | None:
    """Split at the first stroke or comma with a unit behind it."""
    for mark in re.finditer("[/,]", text):
        if mark.start() and unit_of(text[mark.end() :]):
            return text[: mark.start()].strip(), text[mark.end() :].strip()
    return None


def _after_underscore(text: str) -> tuple[str, str] | None:
    """``v_m_s`` and ``v_m_per_s`` are in m/s, ``theta_rad_from_rest`` in rad; a short ending needs a name to fit."""
    parts = text.replace("_per_", "_").split("_")
    if len(parts) > 2:
        label = f"{parts[-2]}/{parts[-1]}"
        unit = unit_of(label)
        if unit is not None and _first_says(parts[0]) in (None, unit.measures):
            return "_".join(parts[:-2]), label
    if len(parts) > 1 and _fits(parts[:-1], parts[-1], parts[-1] in SHORT):
        return "_".join(parts[:-1]), parts[-1]
    inner = [i for i in range(1, len(parts) - 1) if parts[i] not in SHORT and _fits(parts[:i], parts[i], True)]
    if len(inner) == 1 and not unit_of(parts[-1]):
        return "_".join(parts[: inner[0]] + parts[inner[0] + 1 :]), parts[inner[0]]
    return None


def _fits(name: list[str], label: str, must_say: bool) -> bool:
    unit = unit_of(label)
    if unit is None:
        return False
    said = _words("_".join(name)) or (None if label in WORD_ENDINGS else _first_says(name[0]))
    return said == unit.measures or (said is None and not must_say)


def _first_says(part: str) -> Quantity | Literal["other"] | None:
    return FIRST_LETTERS.get(part.rstrip("0123456789")) or _words(part)
