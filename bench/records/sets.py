"""The sets of the measured track: files of ``conf/measured``, each the definition of a real record and its siblings."""

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
"""Fields on which no fit depends; the system is part of a fit's key."""
STRICT = ConfigDict(extra="forbid", frozen=True)


class Known(BaseModel):
    """A value that somebody else states of a quantity, and who.

    A certified one has a standard deviation ``sd`` with ``dof`` degrees of freedom, by which intervals are compared.
    """

    model_config = STRICT
    value: float
    sd: float | None = None
    dof: float | None = None
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
    force_gain: float | None = None
    hold: Hold | None = None
    known: dict[str, Known] = {}
    tests: dict[str, SimulatedSpan] = {}
    unscored: int = 0
    quoted: list[Quoted] = []

    def definition(self) -> dict[str, Any]:
        """Return what its fits depend on, beside the bytes of its files, as JSON holds it."""
        return self.model_dump(mode="json", exclude=NOT_OF_FITS)

    def paths(self, data_root: Path | None) -> tuple[Path, ...]:
        """Return its files in the package or below ``data_root``: all of them, or none where one is not there."""
        root = Path(str(resources("bench").joinpath("data", GROUP))) if self.packaged else data_root
        paths = () if root is None else tuple(root / self.folder / name for name in self.files)
        return paths if all(path.is_file() for path in paths) else ()

    def overrides(self, system: str, methods: Sequence[str], path: Path, timeout_s: float) -> dict[str, list[Any]]:
        """Return the fields that ask for a file of it on the command line."""
        given: dict[str, Any] = {
            "data": str(path), "system": system, "columns": self.columns, "units": self.units, "rate": self.rate,
            "from": self.first, "to": self.last, "force_gain": self.force_gain, "hold": self.hold,
            "timeout_s": timeout_s, **{f"fixed.{name}": value for name, value in self.fixed.items()},
        }  # fmt: skip
        return {"method": list(methods), **{name: [value] for name, value in given.items() if value is not None}}


def set_names() -> list[str]:
    """Return the names of the sets."""
    return sorted(file_names(GROUP))


def measured_set(name: str) -> MeasuredSet:
    """Return a set by its name; raises InputError."""
    if name not in file_names(GROUP):
        raise InputError("set", name, f"known sets: {', '.join(set_names())}")
    return validated(MeasuredSet, read_yaml(GROUP, name))
