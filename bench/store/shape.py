"""The types of what a cell's file holds, as far as readers rely on them.

A checksum says that a file is as it was written, not that this benchmark wrote it. What passes these types can be read
by every command; keys that are not named here may hold anything.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from annotated_types import Len
from pydantic import ConfigDict, Field, StrictBool, StrictStr, TypeAdapter, ValidationError
from typing_extensions import TypedDict

from bench.contract.estimate import Status

Whole = Annotated[int, Field(ge=-(2**63), lt=2**63)]
Float = Annotated[float, Field(strict=True)] | Literal["inf", "-inf", "nan"]
"""JSON has no infinity and no NaN: they are the strings ``inf``, ``-inf`` and ``nan``."""
Number = Float | None
Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]


class _Open(TypedDict, total=False):
    __pydantic_config__ = ConfigDict(extra="allow")  # type: ignore[misc]


class Disturbance(_Open, total=False):
    """What disturbs the data."""

    kind: StrictStr


class Data(_Open, total=False):
    """What decides the data of a replicate."""

    system: StrictStr
    options: dict[str, Any]
    parameters: dict[str, Float]
    initial: Annotated[list[Annotated[list[Finite], Len(1)]], Len(2, 2)]
    snr_db: Float
    duration: Float
    samples: Whole
    force: dict[str, Any] | None
    disturbance: Disturbance | None
    added_mass: list[Float] | None
    measured: list[Whole] | None
    truth: StrictStr


class Given(_Open, total=False):
    """What a method is given beside the data."""

    initial_state: StrictStr
    prior: dict[str, StrictBool | Float | StrictStr] | None


class Description(_Open, total=False):
    """The question that a cell answers."""

    method: StrictStr
    label: StrictStr
    system: StrictStr
    settings: dict[str, Any]
    replicates: Whole
    seed: Whole
    snr_db: Float
    initial_state: StrictStr
    data: Data
    sigma: list[Float]
    told: Given
    sigma_over_peak: Float


class Provenance(_Open, total=False):
    """Where a cell comes from."""

    commit: StrictStr | None
    started: StrictStr | None
    finished: StrictStr | None
    python: StrictStr | None
    system: StrictStr | None
    processor: StrictStr | None
    data: StrictStr
    packages: dict[str, StrictStr | None]
    limits: dict[str, Float]


class Version(_Open, total=False):
    """What computed a cell."""

    method: Whole
    system: Whole
    scoring: Whole


class Head(_Open):
    """The first line of a cell's file."""

    identity: StrictStr
    cell: Description
    statuses: dict[Status, Whole]
    wall_s: Float
    prior_share: dict[str, Float]
    identifiable: dict[str, StrictBool]
    provenance: Provenance
    version: Version
    arrays: StrictStr
    errors: StrictStr
    body: StrictStr


class Rows(_Open):
    """The replicates by column; a score is null where a replicate lacks it."""

    replicate: list[Whole]
    status: list[Status]
    message: list[StrictStr]
    data: list[StrictStr]
    evaluations: list[Whole]
    wall_s: list[Number]
    cpu_s: list[Number]
    peak_memory_mb: list[Number]
    scores: dict[str, list[Number]]


class Body(_Open):
    """The second line of a cell's file."""

    summary: dict[str, dict[str, Number]]
    rows: Rows


DESCRIPTION, HEAD, BODY = TypeAdapter(Description), TypeAdapter(Head), TypeAdapter(Body)


def is_description(value: Any) -> bool:
    """Return whether a value has the types of a cell's description."""
    try:
        DESCRIPTION.validate_python(value)
    except ValidationError:
        return False
    return True
