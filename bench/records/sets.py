"""Sets of the measured track: files of ``conf/measured``, which define real records and their siblings."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files as resources
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from bench.config.files import file_names, read_yaml
from bench.contract.problem import Hold
from bench.errors import InputError
from bench.scenario.declaration import validated

GROUP = "measured"
NOT_OF_FITS = {"title", "licence", "source", "note", "systems", "known", "tests", "quoted", "unscored"}
"""Fields that do not affect a fit, or in the case of the system are part of its key already."""
STRICT = ConfigDict(extra="forbid", frozen=True)


class Known(BaseModel):
    """Published value of a quantity and its source; a certified one has a standard deviation and degrees of freedom."""

    model_config = STRICT
    value: float
    sd: float | None = None
    dof: float | None = None
    source: str


class SimulatedSpan(BaseModel):
    """Test record of a free-run simulation: the samples of a file from ``from`` to ``to`` (s)."""

    model_config = STRICT
    file: str
    first: Annotated[float | None, Field(alias="from")] = None
    last: Annotated[float | None, Field(alias="to")] = None


class Quoted(BaseModel):
    """Published errors on the test records, in their order."""

    model_config = STRICT
    model: str
    errors: list[float]
    source: str


class MeasuredSet(BaseModel):
    """Set of measured records: files, reading options, division into siblings, systems, and known values.

    ``parts`` is the number of consecutive pieces of equal length into which each file is cut; with 1 each file is a
    sibling. Every ``thin``-th sample of a motion is kept, and means of ``thin_force`` samples of a force. Times are
    multiplied by ``time_scale`` after they were cut by ``from`` and ``to``. ``bias_sign`` is the sign of a constant
    force, whose magnitude is a parameter. ``tests`` are records for free-run simulation, whose first ``unscored``
    samples are excluded.
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
    force_gain: float | None = None
    hold: Hold | None = None
    known: dict[str, Known] = {}
    tests: dict[str, SimulatedSpan] = {}
    unscored: int = 0
    quoted: list[Quoted] = []

    def definition(self) -> dict[str, Any]:
        """Return the fields that affect a fit, in types of JSON."""
        return self.model_dump(mode="json", exclude=NOT_OF_FITS)

    def paths(self, data_root: Path | None) -> tuple[Path, ...]:
        """Return the paths of the files in the package or below ``data_root``; empty if a file is missing."""
        root = Path(str(resources("bench").joinpath("data", GROUP))) if self.packaged else data_root
        paths = () if root is None else tuple(root / self.folder / name for name in self.files)
        return paths if all(path.is_file() for path in paths) else ()

    def overrides(self, system: str, methods: Sequence[str], path: Path, timeout_s: float) -> dict[str, list[Any]]:
        """Return the command-line fields by which a file of the set is identified."""
        given: dict[str, Any] = {
            "data": str(path), "system": system, "columns": self.columns, "units": self.units, "rate": self.rate,
            "from": self.first, "to": self.last, "force_gain": self.force_gain, "hold": self.hold,
            "timeout_s": timeout_s, **{f"fixed.{name}": value for name, value in self.fixed.items()},
        }  # fmt: skip
        return {"method": list(methods), **{name: [value] for name, value in given.items() if value is not None}}


def set_names() -> list[str]:
    """Return the names of all sets."""
    return sorted(file_names(GROUP))


def measured_set(name: str) -> MeasuredSet:
    """Return a set by its name; raises InputError."""
    if name not in file_names(GROUP):
        raise InputError("set", name, f"known sets: {', '.join(set_names())}")
    return validated(MeasuredSet, read_yaml(GROUP, name))
