"""One replicate of one cell: what became of it, its scores, and what it took."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from bench.contract.estimate import Status


@dataclass(frozen=True)
class Row:
    """``wall_s`` and ``cpu_s`` are those of the fit alone, ``peak_memory_mb`` by how much its process grew.

    A fit that ran out of time has the scores of the best parameters it had reported, if any, and status ``timeout``.
    ``data`` is a digest of the samples, forces and prior that the method was given: equal where two methods met the
    same data.
    """

    replicate: int
    status: Status
    message: str = ""
    scores: Mapping[str, float] = field(default_factory=dict)
    wall_s: float = math.nan
    cpu_s: float = math.nan
    peak_memory_mb: float = math.nan
    evaluations: int = 0
    data: str = ""
