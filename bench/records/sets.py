"""The sets of the measured track: files of ``conf/measured``, each the definition of a real record and its siblings."""

from __future__ import annotations

import hashlib
import json
from importlib.resources import files as resources
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from bench.config.files import file_names, read_yaml
from bench.contract.problem import Hold
from bench.errors import InputError
from bench.scenario.declaration import validated

GROUP = "measured"
OF_READERS = {"title", "licence", "source", "note", "known", "tests", "quoted", "unscored"}
"""Fields that no fit hangs on."""
STRICT = ConfigDict(extra="forbid", frozen=True)


class Known(BaseModel):
    """A value that somebody else states of a quantity, perhaps with its standard deviation, and who."""

    model_config = STRICT
    value: float
    sd: float | None = None
    source: str


class SimulatedSpan(BaseModel):
    """A record that fitted models are simulated over, from ``from`` to ``to`` (s) of a file's clock."""

    model_config = STRICT
    file: str
    first: Annotated[float | None, Field(alias="from")] = None
    last: Annotated[float | None, Field(alias="to")] = None


class Quoted(BaseModel):
    """Errors over the test parts that others have published, in the order of the parts."""

    model_config = STRICT
    model: str
    errors: list[float]
    source: str


class MeasuredSet(BaseModel):
    """A set: where its files are, how they are read, cut into siblings and described, and what is known of them.

    ``parts``: consecutive pieces of equal length that each file is cut into; with 1 each file is a sibling. ``thin``:
    every so many samples of the motion are kept; ``thin_force``: means of so many samples of the force.
    ``time_scale``: what the file's times are multiplied with after ``from`` and ``to`` have cut them. ``bias_sign``:
    the sign of a bias, whose size is positive. ``tests``: what fitted models are simulated over, without the first
    ``unscored`` samples.
    """

    model_config = STRICT
    title: str
    licence: str
    source: str
    note: str = ""
    folder: str
    packaged: bool = False
    files: Annotated[list[str], Field(min_length=1)]
    columns: str | None = None
    units: str | None = None
    rate: float | None = None
    first: Annotated[float | None, Field(alias="from")] = None
    last: Annotated[float | None, Field(alias="to")] = None
    time_scale: Annotated[float, Field(gt=0)] = 1.0
    parts: Annotated[int, Field(ge=1)] = 1
    thin: Annotated[int, Field(ge=1)] = 1
    thin_force: Annotated[int, Field(ge=1)] = 1
    systems: Annotated[list[str], Field(min_length=1)]
    fixed: dict[str, float] = {}
    bias_sign: Annotated[int, Field(ge=-1, le=1)] = 1
    force_gain: float = 1.0
    hold: Hold = "linear"
    known: dict[str, Known] = {}
    tests: dict[str, SimulatedSpan] = {}
    unscored: int = 0
    quoted: list[Quoted] = []

    def definition(self) -> str:
        """What fits of it hang on, beside the bytes of its files, as a digest."""
        stated = self.model_dump(mode="json", exclude=OF_READERS | {"systems"})
        return hashlib.sha256(json.dumps(stated, sort_keys=True).encode()).hexdigest()[:16]

    def place(self, data_root: Path | None) -> Path | None:
        """The folder of its files: in the package, or below ``data_root``; None where that is not told."""
        if self.packaged:
            return Path(str(resources("bench").joinpath("data", GROUP, self.folder)))
        return None if data_root is None else data_root / self.folder

    def paths(self, data_root: Path | None) -> tuple[Path, ...]:
        """Its files, all of them there, or none."""
        place = self.place(data_root)
        if place is None or not all((place / name).is_file() for name in self.files):
            return ()
        return tuple(place / name for name in self.files)

    def overrides(self, system: str, methods: list[str], path: Path, timeout_s: float) -> dict[str, list[Any]]:
        """The fields that ask for it on the command line, of a file of it."""
        fields: dict[str, Any] = {
            "columns": self.columns, "units": self.units, "rate": self.rate, "from": self.first, "to": self.last,
        }  # fmt: skip
        told = {f"fixed.{name}": value for name, value in self.fixed.items()}
        of_force = self.model_fields_set & {"force_gain", "hold"}
        force: dict[str, Any] = {name: getattr(self, name) for name in sorted(of_force)}
        stated = {name: value for name, value in fields.items() if value is not None}
        given = {"data": str(path), "system": system, **stated, **force, "timeout_s": timeout_s, **told}
        return {"method": list(methods), **{key: [value] for key, value in given.items()}}


def set_names() -> list[str]:
    """The names of the sets."""
    return sorted(file_names(GROUP))


def measured_set(name: str) -> MeasuredSet:
    """A set by its name; raises InputError."""
    if name not in file_names(GROUP):
        raise InputError("set", name, f"known sets: {', '.join(set_names())}")
    return validated(MeasuredSet, read_yaml(GROUP, name))
