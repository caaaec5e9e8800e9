"""One replicate of one cell: what became of it, its scores, and what it took; and the scores of many by column."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

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


def score_columns(rows: Sequence[Row]) -> dict[str, np.ndarray]:
    """Return every score of some rows by name, (n,), NaN where a row has none; in the order in which rows have them."""
    forms: dict[tuple[str, ...], list[int]] = {}
    for i, row in enumerate(rows):
        forms.setdefault(tuple(row.scores), []).append(i)
    columns = {name: np.full(len(rows), np.nan) for form in forms for name in form}
    for form, members in forms.items():
        values = np.array([list(rows[i].scores.values()) for i in members], float)
        for name, column in zip(form, values.T, strict=True):
            columns[name][members] = column
    return columns
