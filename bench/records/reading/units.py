"""Units of measured records: quantity and size in SI units.

General libraries of units are not suitable: there ``g`` is a gram, ``in`` may be a keyword, and angles are
dimensionless.
"""

from __future__ import annotations

import math
import re
from typing import Literal, NamedTuple

Measures = Literal["displacement", "velocity", "acceleration", "force"]
Quantity = Literal["time", "displacement", "velocity", "acceleration", "force"]
MEASURES: dict[str, Measures] = {"x": "displacement", "v": "velocity", "a": "acceleration", "f": "force"}
LETTERS: dict[str, Quantity] = {"t": "time", **MEASURES}
"""Quantities by role of a column; all roles but that of the time may have the number of a DOF."""
MEASURED_BY: dict[str, Measures] = {**MEASURES, "b": "acceleration"}
"""The same with the acceleration of the base, a role that is only specified by the user."""


class Unit(NamedTuple):
    """Quantity of a unit, its size in SI units, and the symbol of the SI unit.

    Torques are treated as forces, angles as displacements.
    """

    measures: Quantity
    size: float
    symbol: str


SPELLINGS: dict[tuple[Quantity, str], dict[str, float]] = {
    ("time", "s"): {
        "s sec secs second seconds": 1.0, "ms msec msecs millisecond milliseconds": 1e-3,
        "us usec usecs microsecond microseconds": 1e-6, "ns nanosecond nanoseconds": 1e-9,
        "min mins minute minutes": 60.0,
    },
    ("displacement", "m"): {
        "m metre metres meter meters": 1.0, "cm centimetre centimetres centimeter centimeters": 1e-2,
        "mm millimetre millimetres millimeter millimeters": 1e-3, "um micron microns micrometre micrometer": 1e-6,
        "nm nanometre nanometer": 1e-9, "in inch inches": 0.0254, "ft foot feet": 0.3048,
    },
    ("displacement", "rad"): {
        "rad rads radian radians": 1.0, "mrad": 1e-3, "deg degs degree degrees °": math.pi / 180,
        "rev revs revolution revolutions": 2 * math.pi,
    },
    ("velocity", "rad/s"): {"rpm": 2 * math.pi / 60, "dps": math.pi / 180},
    ("acceleration", "m/s²"): {"g": 9.80665, "mg": 9.80665e-3, "gal Gal": 0.01},
    ("force", "N"): {"N newton newtons": 1.0, "kN KN": 1e3, "mN": 1e-3, "MN": 1e6, "uN": 1e-6, "lbf": 4.4482216152605},
}  # fmt: skip
UNITS = {
    spelling: Unit(measures, size, symbol)
    for (measures, symbol), sizes in SPELLINGS.items()
    for spellings, size in sizes.items()
    for spelling in spellings.split()
}
KNOWN = {
    "time": "s, ms, us, min", "displacement": "m, cm, mm, um, nm, in, ft, rad, mrad, deg, rev",
    "velocity": "m/s, mm/s, rad/s, deg/s, rpm", "acceleration": "m/s², mm/s², g, gal, rad/s²",
    "force": "N, kN, mN, lbf, N·m",
}  # fmt: skip
"""Units listed by errors, by quantity."""
CASE_DECIDES = {"m", "mn", "nm", "un", "g", "mg", "n", "ns"}
"""Units whose meaning depends on the case: MN or mN, N·m or nm, gauss or g."""


def unit_of(text: str) -> Unit | None:
    """Return a unit by its symbol, None if unknown; the case is ignored if that is unambiguous."""
    plain = _plain(text)
    small = plain.lower()
    risk = small in CASE_DECIDES or not (plain.isupper() or (plain.istitle() and len(plain) > 2))
    return _known(plain) or (None if risk else _known(small))


def _plain(text: str) -> str:
    """Normalise the spelling of a unit: ``(m / s²)`` to ``m/s^2``, ``N m`` to ``N·m``, ``µm`` to ``um``."""
    text = re.sub(r"[µμ]", "u", text.strip().strip("\"'").replace("**", "^"))
    text = text.replace("⁻¹", "^-1").replace("⁻²", "^-2").replace("²", "^2")
    text = re.sub(r"[(){}]", "", text).strip().rstrip(".")
    text = re.sub(r"\s*([/^])\s*", r"\1", re.sub(r"_per_|\s+per\s+", "/", text))
    text = re.sub(r"\s*[·⋅∙×*]\s*|\s+|(?<=[A-Za-z])\.(?=[A-Za-z])", "·", text)
    text = re.sub(r"·([sS])\^-", r"/\1^", text).removesuffix("^1")
    return re.sub(r"/(?:sec|second)(?![a-z])", "/s", text)


def _known(name: str) -> Unit | None:
    """Return a unit of the table, a displacement over time or time squared, or a force times a length."""
    if name in UNITS:
        return UNITS[name]
    if over := re.fullmatch(r"(.+?)(/s)(\^2|2|/s)?", name):
        length, squared = UNITS.get(over[1]), over[3] is not None
        if length and length.measures == "displacement":
            symbol = length.symbol + ("/s²" if squared else "/s")
            return Unit("acceleration" if squared else "velocity", length.size, symbol)
    if moment := re.fullmatch(r"(.+)[·-](.+)|(.*N)(mm?)", name):
        force, arm = UNITS.get(moment[1] or moment[3]), UNITS.get(moment[2] or moment[4])
        if force and arm and force.measures == "force" and arm.symbol == "m":
            return Unit("force", force.size * arm.size, "N·m")
    return None
