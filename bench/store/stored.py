"""What is stored of a cell, whether it lies in a user's folder or in the published archive."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from bench.contract.estimate import Status
from bench.scoring.row import Row, Rows

MARK = " (submitted)"
"""What the label of a cell ends with that somebody else computed, so that every table and page shows it."""
SUBMITTED = "submitted"
"""The field of a submitted cell's provenance that states what was verified of it."""


class Arrays(Mapping[str, np.ndarray]):
    """Arrays that are read when one of them is first needed; that raises InputError where they are damaged."""

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
    """A cell's description, its rows, the summary of every metric, and where they come from.

    ``wall_s`` is the time of all fits together, ``version`` the version that computed it (:mod:`bench.store.version`).
    ``arrays`` are those kept of one replicate, ``tracebacks`` those of the replicates that failed.
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
        """``ok`` where any replicate succeeded, else the most frequent failure."""
        statuses = self.columns.statuses
        return Status.OK if Status.OK in statuses else max(set(statuses), key=statuses.count)

    @property
    def submitted(self) -> bool:
        """True of a cell that came with a submission."""
        return SUBMITTED in self.provenance

    def marked(self, facts: Mapping[str, Any]) -> StoredCell:
        """Return the cell as one that was submitted; ``facts`` state where it came from and what was verified of it.

        A label has no part in a cell's identity.
        """
        cell = {**self.cell, "label": f"{unmarked(str(self.cell['label']))}{MARK}"}
        return replace(self, cell=cell, provenance={**self.provenance, SUBMITTED: dict(facts)})

    def without_mark(self) -> StoredCell:
        """Return the cell as its method calls it, without a mark that it came with."""
        provenance = {key: value for key, value in self.provenance.items() if key != SUBMITTED}
        return replace(self, cell={**self.cell, "label": unmarked(str(self.cell["label"]))}, provenance=provenance)


def unmarked(label: str) -> str:
    """Return a label without the mark."""
    return label.removesuffix(MARK)


@dataclass(frozen=True)
class CellHead:
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
