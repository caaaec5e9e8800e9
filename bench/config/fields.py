"""The fields of a run: type, limits, default, and the text of the help and reference pages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

from bench.config.declaration import Field, fields_of
from bench.contract.modal import Response
from bench.contract.problem import Hold
from bench.scenario.declaration import STRICT, Positive, Within

MOST_WORKERS = 1024
MOST_REPLICATES = 1_000_000
MOST_TIMEOUT_S, LEAST_MEMORY_MB, MOST_MEMORY_MB = 1e9, 100.0, 1e9
Group = Mapping[str, Any]


@dataclass(frozen=True)
class Config:
    """The fields of a run. The fields of the scenario are not parsed here; :class:`bench.config.schema.Job` does so."""

    __pydantic_config__ = STRICT
    method: Annotated[Group, "method or variant of a method; method.<setting> changes a setting"]
    system: Annotated[Group, "scenario, or the path of your own <name>.yaml; system.<field> changes a field"]
    prior: Annotated[Group, "prior distribution of the parameters"]
    disturbance: Annotated[Group, "violated assumption of the methods; disturbance.size and other fields"]
    snr: Annotated[Any, "signal-to-noise ratio (dB): mean square of the clean samples over the noise variance"] = 20
    initial_state: Annotated[Any, "known or unknown: whether initial conditions are given to the method"] = "known"
    replicates: Annotated[
        int, Within(ge=1, le=MOST_REPLICATES), "number of data sets, each with its own noise and nominal values"
    ] = 20
    seed: Annotated[int, Within(ge=0, lt=2**63), "random seed; the data do not depend on the method"] = 0
    store: Annotated[Path, "folder of finished cells, which are not computed again"] = Path("outputs/rows")
    archive: Annotated[
        str | None, "folder of published cells, which are not computed again, or none; unset: that of the checkout"
    ] = None
    format: Annotated[Literal["table", "json"], "output format"] = "table"
    workers: Annotated[
        Annotated[int, Within(ge=1, le=MOST_WORKERS)] | None, "number of worker processes; unset: one per core"
    ] = None
    timeout_s: Annotated[float, Within(gt=0, le=MOST_TIMEOUT_S), "time limit per replicate (s)"] = 600
    memory_mb: Annotated[float, Within(ge=LEAST_MEMORY_MB, le=MOST_MEMORY_MB), "memory limit per fit (MB)"] = 4096
    retry: Annotated[
        str, "failed, or statuses: repeat stored replicates with this outcome; failed also repeats damaged cells"
    ] = "none"
    dry_run: Annotated[bool, "list the cells with the reason and expected time of each; run nothing"] = False
    cells_per_job: Annotated[int, Within(ge=1, le=1_000_000), "cells per job of a cluster launcher"] = 20
    data: Annotated[
        str | None, "measured record instead of a scenario, or several of the same system: run1.csv,run2.csv"
    ] = None
    columns: Annotated[str | None, "columns, if the file does not name them: t:0,x:3"] = None
    units: Annotated[str | None, "units, if the file does not state them: t:ms,x:mm"] = None
    rate: Annotated[Positive | None, "sampling rate (1/s), if there is no column of times"] = None
    from_: Annotated[float | None, "start of the part to use (s, in the record's time)"] = None
    to: Annotated[float | None, "end of the part to use (s)"] = None
    decimate: Annotated[int, Within(ge=1, le=10_000), "keep every Nth sample, after a low-pass filter"] = 1
    modes: Annotated[str | None, "number of modes, or auto; method= then names modal methods"] = None
    band: Annotated[str | None, "with modes=: frequency band (Hz) in which modes are sought, such as 10:40"] = None
    response: Annotated[Response | None, "with modes=: kind of frequency response, if the file does not state it"] = (
        None
    )
    window: Annotated[
        float, Within(ge=0), "with modes=: decay rate (1/s) of an exponential window already applied to the data"
    ] = 0
    base: Annotated[str | None, "column of the ground acceleration that excites the motion; requires motion="] = None
    motion: Annotated[
        Literal["relative", "absolute"] | None,
        "with base=: motion relative to the ground, or absolute as of an accelerometer on the mass",
    ] = None
    detrend: Annotated[bool | None, "remove linear sensor drift; unset: where it is significant"] = None
    force_gain: Annotated[float, "force scale factor; -1 changes the sign"] = 1
    hold: Annotated[Hold, "interpolation of the force between samples"] = "linear"
    fixed: Annotated[Mapping[str, Annotated[float, Within(ge=0)]], "parameters with known values: fixed.l=1"] = field(
        default_factory=dict
    )
    nominal: Annotated[Mapping[str, Positive], "with prior=: nominal values of the parameters: nominal.m=1.2"] = field(
        default_factory=dict
    )
    start: Annotated[
        list[float] | None, "with initial_state=known: initial conditions [displacement,...,velocity,...]"
    ] = None
    plot: Annotated[
        Literal["auto", "always", "never"], "plot of the fit in the terminal; auto: if the output is a terminal"
    ] = "auto"
    picture: Annotated[str | None, "file for a picture of the fit, <name>.svg"] = None


GROUPS = ("method", "system", "prior", "disturbance")
"""Fields whose value is a choice by name, with fields below it."""
SWEPT = (*GROUPS, "snr", "initial_state", "replicates", "seed")
"""Fields over which ``-m`` sweeps."""
RECORD = (
    "columns", "units", "rate", "from", "to", "decimate", "detrend", "force_gain", "hold", "fixed", "nominal", "start",
    "plot", "picture", "modes", "band", "response", "window", "base", "motion",
)  # fmt: skip
"""Fields that require a measured record (``data``)."""
MODAL = (
    "data", "modes", "band", "method", "columns", "units", "rate", "from", "to", "decimate", "detrend", "format",
    "plot", "picture", "response", "window", "timeout_s", "memory_mb",
)  # fmt: skip
"""Fields that can be set together with ``modes``."""


@cache
def declared() -> dict[str, Field]:
    """Return the fields by their names on the command line: ``from`` for ``from_``."""
    return fields_of(Config)


@cache
def taken_as_written() -> tuple[str, ...]:
    """Return the fields whose value is a text or path, which Hydra's grammar does not parse."""
    return tuple(name for name, field in declared().items() if field.types & {str, Path})


def defaults() -> dict[str, Any]:
    """Return the defaults of the fields outside the groups, as plain values."""
    stated = {}
    for f in fields(Config)[len(GROUPS) :]:
        value = f.default if f.default_factory is MISSING else f.default_factory()
        stated[f.name.rstrip("_")] = str(value) if isinstance(value, Path) else value
    return stated
