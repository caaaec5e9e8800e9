"""What is stored of a cell, whether it lies in a user's folder or in the published archive."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from bench.contract.estimate import Status
from bench.scoring.row import Row
from bench.store.columns import Columns, MadeRows


@dataclass(frozen=True)
class StoredCell:
    """A cell's description, its rows, the summary of every metric, and where they come from.

    ``wall_s`` is the time of all fits together, ``version`` the version that computed it (:mod:`bench.store.version`).
    ``arrays`` and ``errors`` (tracebacks) name the files beside it, or are empty.
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
    arrays: str = ""
    errors: str = ""

    @cached_property
    def columns(self) -> Columns:
        """The rows by column."""
        return self.rows if isinstance(self.rows, Columns) else MadeRows(self.rows)

    @property
    def n_ok(self) -> int:
        """The number of replicates that succeeded."""
        return self.columns.statuses.count(Status.OK)

    @property
    def status(self) -> Status:
        """``ok`` where any replicate succeeded, else the most frequent failure."""
        statuses = self.columns.statuses
        return Status.OK if Status.OK in statuses else max(set(statuses), key=statuses.count)


@dataclass(frozen=True)
class Head:
    """What is known of a stored cell without reading its rows.

    ``statuses`` counts the replicates by status; ``stamp`` is the time at which the file was written (ns; 0 in the
    archive); ``problem`` says why the file is no whole cell, or is empty.
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
