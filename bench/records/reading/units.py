"""Units of measured records: what each measures, and how much one of it is in SI."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

Measures = Literal["displacement", "velocity", "acceleration", "force"]
Quantity = Literal["time", "displacement", "velocity", "acceleration", "force"]


@dataclass(frozen=True)
class Unit:
    """What a unit measures, how much one of it is in SI, and that SI unit. A torque is a force, an angle a way."""

    measures: Quantity
    size: float
    symbol: str


TIMES = {
    "s sec secs second seconds": 1.0, "ms msec msecs millisecond milliseconds": 1e-3,
    "us usec usecs microsecond microseconds": 1e-6, "ns nanosecond nanoseconds": 1e-9, "min mins minute minutes": 60.0,
}  # fmt: skip
LENGTHS = {
    "m metre metres meter meters": 1.0, "cm centimetre centimetres centimeter centimeters": 1e-2,
    "mm millimetre millimetres millimeter millimeters": 1e-3, "um micron microns micrometre micrometer": 1e-6,
    "nm nanometre nanometer": 1e-9, "in inch inches": 0.0254, "ft foot feet": 0.3048,
}  # fmt: skip
ANGLES = {
    "rad rads radian radians": 1.0, "mrad": 1e-3, "deg degs degree degrees °": math.pi / 180,
    "rev revs revolution revolutions": 2 * math.pi,
}  # fmt: skip
FORCES = {"N newton newtons": 1.0, "kN KN": 1e3, "mN": 1e-3, "MN": 1e6, "uN": 1e-6, "lbf": 4.4482216152605}
OTHERS = {
    "g": Unit("acceleration", 9.80665, "m/s²"), "mg": Unit("acceleration", 9.80665e-3, "m/s²"),
    "gal": Unit("acceleration", 0.01, "m/s²"), "Gal": Unit("acceleration", 0.01, "m/s²"),
    "rpm": Unit("velocity", 2 * math.pi / 60, "rad/s"), "dps": Unit("velocity", math.pi / 180, "rad/s"),
}  # fmt: skip
PER_SECOND, PER_SECOND_SQUARED = ("/s", "·s^-1"), ("/s^2", "/s2", "/s/s", "·s^-2")
CASE_DECIDES = {"m", "mn", "nm", "un", "g", "mg", "n", "ns"}
"""In capitals these may be other units: MN or mN, N·m or nm, gauss or g."""


def _spelled(table: Mapping[str, float]) -> Iterator[tuple[str, float]]:
    for spellings, size in table.items():
        for spelling in spellings.split():
            yield spelling, size


def _all_units() -> dict[str, Unit]:
    units = {name: Unit("time", size, "s") for name, size in _spelled(TIMES)}
    for table, symbol in ((LENGTHS, "m"), (ANGLES, "rad")):
        for name, size in _spelled(table):
            units[name] = Unit("displacement", size, symbol)
            units |= {name + per: Unit("velocity", size, symbol + "/s") for per in PER_SECOND}
            units |= {name + per: Unit("acceleration", size, symbol + "/s²") for per in PER_SECOND_SQUARED}
    for name, size in _spelled(FORCES):
        units[name] = Unit("force", size, "N")
        for arm, length in _spelled(LENGTHS):
            joints = ("·", "-", "") if arm in ("m", "mm") else ("·", "-")
            units |= {name + joint + arm: Unit("force", size * length, "N·m") for joint in joints}
    return units | OTHERS


def _plain(text: str) -> str:
    """One spelling of a unit: ``(m / s²)`` is ``m/s^2``, ``N m`` is ``N·m``, ``µm`` is ``um``."""
    text = text.strip().strip("\"'").replace("µ", "u").replace("μ", "u").replace("**", "^")
    text = text.replace("⁻¹", "^-1").replace("⁻²", "^-2").replace("²", "^2")
    text = re.sub(r"[(){}]", "", text).strip().rstrip(".")
    text = re.sub(r"\s*([/^])\s*", r"\1", re.sub(r"_per_|\s+per\s+", "/", text))
    text = re.sub(r"\s*[·⋅∙×*]\s*|\s+|(?<=[A-Za-z])\.(?=[A-Za-z])", "·", text)
    return re.sub(r"/(?:sec|second)(?![a-z])", "/s", text)


UNITS = _all_units()
KNOWN = {
    "time": "s, ms, us, min", "displacement": "m, cm, mm, um, nm, in, ft, rad, mrad, deg, rev",
    "velocity": "m/s, mm/s, rad/s, deg/s, rpm", "acceleration": "m/s², mm/s², g, gal, rad/s²",
    "force": "N, kN, mN, lbf, N·m",
}  # fmt: skip
"""The units that an error names, by what they measure."""


def unit_of(text: str) -> Unit | None:
    """The unit as written, None where it is not known; capitals are read as small letters where that is no risk."""
    plain = _plain(text)
    known = UNITS.get(plain)
    small = plain.lower()
    if known is None and small not in CASE_DECIDES and (plain.isupper() or (plain.istitle() and len(plain) > 2)):
        known = UNITS.get(small)
    return known
