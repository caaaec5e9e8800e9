"""The fields of a run, declared once: type and limits, default, and the text of help and reference pages."""

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
    """The fields of a run. Those of the scenario's groups stand here as they are written; a :class:`Job` reads them."""

    __pydantic_config__ = STRICT
    method: Annotated[Group, "a method or one of its variants; method.<setting> sets any setting of it"]
    system: Annotated[Group, "a scenario, or a file of your own: <path>.yaml; system.<field> sets any field of it"]
    prior: Annotated[Group, "what is known of the parameters before the data"]
    disturbance: Annotated[Group, "which assumption of the methods is broken; disturbance.size and others"]
    snr: Annotated[Any, "dB: mean square of the clean samples over the noise variance"] = 20
    initial_state: Annotated[Any, "known or unknown: whether a method is given the initial state"] = "known"
    replicates: Annotated[
        int, Within(ge=1, le=MOST_REPLICATES), "data sets, each with its own noise and nominal values"
    ] = 20
    seed: Annotated[int, Within(ge=0, lt=2**63), "root of all random streams; data never depend on the method"] = 0
    store: Annotated[Path, "folder of finished cells, which are not computed again"] = Path("outputs/rows")
    archive: Annotated[
        str | None, "published cells, not computed again: a folder, or none; unset: those of the checkout"
    ] = None
    format: Annotated[Literal["table", "json"], "how results are printed"] = "table"
    workers: Annotated[
        Annotated[int, Within(ge=1, le=MOST_WORKERS)] | None, "processes that fit; unset: one a core"
    ] = None
    timeout_s: Annotated[float, Within(gt=0, le=MOST_TIMEOUT_S), "s, limit of one replicate"] = 600
    memory_mb: Annotated[float, Within(ge=LEAST_MEMORY_MB, le=MOST_MEMORY_MB), "MB, limit of one fit"] = 4096
    retry: Annotated[
        str, "failed, or statuses: stored replicates that failed are tried again; failed: damaged cells, too"
    ] = "none"
    dry_run: Annotated[bool, "list the cells, why each would run and how long it may take; run nothing"] = False
    cells_per_job: Annotated[int, Within(ge=1, le=1_000_000), "cells of a job of a cluster's launcher"] = 20
    data: Annotated[str | None, "a measured record instead of a scenario, or several of one rig: run1.csv,run2.csv"] = (
        None
    )
    columns: Annotated[str | None, "which column is what, where the file does not say: t:0,x:3"] = None
    units: Annotated[str | None, "in which unit, where the file does not say: t:ms,x:mm"] = None
    rate: Annotated[Positive | None, "samples a second, where no column is the time"] = None
    from_: Annotated[float | None, "s of the record's own clock, where the part to use begins"] = None
    to: Annotated[float | None, "s, where it ends"] = None
    decimate: Annotated[int, Within(ge=1, le=10_000), "keep every n-th sample, after a low-pass filter"] = 1
    modes: Annotated[str | None, "auto, or a number: several modes; method= then names modal methods"] = None
    band: Annotated[str | None, "Hz, with modes=: in which band they are looked for, as 10:40"] = None
    response: Annotated[Response | None, "with modes=: what frequency responses are, where the file does not say"] = (
        None
    )
    window: Annotated[
        float, Within(ge=0), "1/s, with modes=: decay rate of an exponential window that is in the data already"
    ] = 0
    base: Annotated[str | None, "column of the ground's acceleration, which drives the motion; with motion="] = None
    motion: Annotated[
        Literal["relative", "absolute"] | None, "with base=: relative to the ground, or of an accelerometer on the mass"
    ] = None
    detrend: Annotated[bool | None, "remove a straight line from the motion; by default where significant"] = None
    force_gain: Annotated[float, "factor of the column of the force; -1 turns its sign"] = 1
    hold: Annotated[Hold, "how the force runs between its samples"] = "linear"
    fixed: Annotated[Mapping[str, Annotated[float, Within(ge=0)]], "known parameters: fixed.l=1"] = field(
        default_factory=dict
    )
    nominal: Annotated[Mapping[str, Positive], "with prior=: the nominal value of each parameter, nominal.m=1.2"] = (
        field(default_factory=dict)
    )
    start: Annotated[list[float] | None, "with initial_state=known: [displacement,...,velocity,...]"] = None
    plot: Annotated[
        Literal["auto", "always", "never"], "the fit in the terminal; auto: where the output is a terminal"
    ] = "auto"
    picture: Annotated[str | None, "the fit as a file, <name>.svg"] = None


GROUPS = ("method", "system", "prior", "disturbance")
"""Fields whose value is a choice by name, with fields below it."""
SWEPT = (*GROUPS, "snr", "initial_state", "replicates", "seed")
"""Fields of a cell: -m sweeps over their values."""
RECORD = (
    "columns", "units", "rate", "from", "to", "decimate", "detrend", "force_gain", "hold", "fixed", "nominal", "start",
    "plot", "picture", "modes", "band", "response", "window", "base", "motion",
)  # fmt: skip
"""Fields of a measured record, which need ``data``."""
MODAL = (
    "data", "modes", "band", "method", "columns", "units", "rate", "from", "to", "decimate", "detrend", "format",
    "plot", "picture", "response", "window", "timeout_s", "memory_mb",
)  # fmt: skip
"""Fields of a measured record of which modes are sought; others are refused there."""


@cache
def declared() -> dict[str, Field]:
    """Return the fields by the name that is written: ``from`` for ``from_``."""
    return fields_of(Config)


@cache
def taken_as_written() -> tuple[str, ...]:
    """Return the fields whose value is a text or a path, which may hold any letter."""
    return tuple(name for name, field in declared().items() if field.types & {str, Path})


def defaults() -> dict[str, Any]:
    """Return the default of each field outside the groups, as a configuration file writes it."""
    stated = {}
    for f in fields(Config)[len(GROUPS) :]:
        value = f.default if f.default_factory is MISSING else f.default_factory()
        stated[f.name.rstrip("_")] = str(value) if isinstance(value, Path) else value
    return stated
