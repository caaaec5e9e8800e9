"""The content of a stored cell, read from a user's folder or from the published archive."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from bench.contract.estimate import Status
from bench.scoring.row import Row, Rows

MARK = " (submitted)"
"""Suffix of the label of a submitted cell, which tables and pages show."""
SUBMITTED = "submitted"
"""Field of a submitted cell's provenance with the facts that were verified."""


class Arrays(Mapping[str, np.ndarray]):
    """Arrays that are read when first needed, which raises InputError if they are damaged."""

    def __init__(self, read: Callable[[], Mapping[str, np.ndarray]]) -> None:
        self._read = read

    @cached_property
    def _arrays(self) -> dict[str, np.ndarray]:
        return dict(self._read())

    def __getitem__(self, name: str) -> np.ndarray:
        return self._arrays[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._arrays)

    def __len__(self) -> int:
        return len(self._arrays)

    def __reduce__(self) -> tuple[Any, ...]:
        return dict, (self._arrays,)


@dataclass(frozen=True)
class StoredCell:
    """A cell's description, rows, summaries by metric, and provenance.

    ``wall_s`` is the total time of the fits (s), ``version`` the version that computed it (:mod:`bench.store.version`).
    ``arrays`` belong to one replicate, ``tracebacks`` to the failed replicates.
    """

    identity: str
    cell: dict[str, Any]
    rows: Sequence[Row]
    summary: Mapping[str, Mapping[str, float]]
    prior_share: dict[str, float]
    identifiable: dict[str, bool]
    wall_s: float
    provenance: dict[str, Any] = field(default_factory=dict)
    version: dict[str, Any] = field(default_factory=dict)
    arrays: Mapping[str, np.ndarray] = field(default_factory=dict, compare=False, repr=False)
    tracebacks: str = ""

    @cached_property
    def columns(self) -> Rows:
        """The rows by column."""
        return Rows.from_rows(self.rows)

    @property
    def n_ok(self) -> int:
        """The number of replicates that succeeded."""
        return self.columns.statuses.count(Status.OK)

    @property
    def status(self) -> Status:
        """``ok`` if any replicate succeeded, otherwise the most frequent failure."""
        statuses = self.columns.statuses
        return Status.OK if Status.OK in statuses else max(set(statuses), key=statuses.count)

    @property
    def submitted(self) -> bool:
        """True if the cell came with a submission."""
        return SUBMITTED in self.provenance

    def marked(self, facts: Mapping[str, Any]) -> StoredCell:
        """Return the cell marked as submitted; ``facts`` describe its origin and what was verified.

        The label is not part of a cell's identity.
        """
        cell = {**self.cell, "label": f"{unmarked(str(self.cell['label']))}{MARK}"}
        return replace(self, cell=cell, provenance={**self.provenance, SUBMITTED: dict(facts)})

    def without_mark(self) -> StoredCell:
        """Return the cell without the mark of a submission."""
        provenance = {key: value for key, value in self.provenance.items() if key != SUBMITTED}
        return replace(self, cell={**self.cell, "label": unmarked(str(self.cell["label"]))}, provenance=provenance)


def unmarked(label: str) -> str:
    """Return a label without the mark."""
    return label.removesuffix(MARK)


@dataclass(frozen=True)
class CellHead:
    """The part of a stored cell that can be read without its rows.

    ``statuses`` counts the replicates by status; ``stamp`` is the time at which the file was written (ns; 0 in the
    archive); ``problem`` is the reason why the file is damaged, or empty.
    """

    identity: str
    cell: Mapping[str, Any] = field(default_factory=dict)
    statuses: Mapping[str, int] = field(default_factory=dict)
    version: Mapping[str, Any] = field(default_factory=dict)
    wall_s: float = 0.0
    stamp: int = 0
    problem: str = ""

    @property
    def replicates(self) -> int:
        """The number of stored replicates."""
        return sum(self.statuses.values())

    @property
    def label(self) -> str:
        """The name of the method's variant in tables."""
        return str(self.cell.get("label") or self.cell.get("method", "?"))
