"""The replicates of a cell: status, scores, time and memory, stored by column."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from bench.contract.estimate import Status


@dataclass(frozen=True)
class Row:
    """One replicate.

    ``wall_s`` and ``cpu_s`` are the times of the fit alone (s), ``peak_memory_mb`` the growth of its process (MB). A
    fit that exceeded its time limit has status ``timeout`` and the scores of the last parameters that it reported, if
    any. ``data`` is a digest of the samples, forces and prior given to the method; it is equal for two methods on the
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


NUMBERS = ("wall_s", "cpu_s", "peak_memory_mb")
PLAIN = ("replicate", "message", *NUMBERS, "evaluations", "data")
"""Columns of a row other than its status and its scores."""

STATISTICS = ("mean", "median", "ci_low", "ci_high", "bound", "excess", "n_ok")
"""Statistics of a metric over the replicates. A failed replicate counts as an infinite error in mean, median, interval.

``excess`` is the root mean square error of the successful replicates divided by ``bound``; 1 is the smallest that an
unbiased method can reach. Coverages, levels at the true value (``_pit``) and shares of the record are averaged over the
successful replicates; the interval is Wilson's for coverages and Student's t for the others.
"""


class Rows(Sequence[Row]):
    """A sequence of replicates, stored by column; :class:`Row` objects are made only when indexed.

    ``column`` returns a column of :data:`PLAIN` or a score of ``score_names``, (n,); missing scores are NaN.
    """

    def __init__(
        self, statuses: Iterable[Status], column: Callable[[str], Sequence[Any]], score_names: Collection[str]
    ) -> None:
        self.statuses, self._column, self._names = tuple(statuses), column, score_names

    @classmethod
    def from_rows(cls, rows: Iterable[Row]) -> Rows:
        """Convert rows to columns."""
        if isinstance(rows, Rows):
            return rows
        rows = tuple(rows)
        plain = {name: [getattr(row, name) for row in rows] for name in PLAIN}
        return cls.from_columns([row.status for row in rows], plain, score_columns([row.scores for row in rows]))

    @classmethod
    def from_columns(
        cls, statuses: Iterable[Status], plain: Mapping[str, Sequence[Any]], scores: Mapping[str, np.ndarray]
    ) -> Rows:
        """Make rows of all columns of :data:`PLAIN` and of scores (n,), NaN where missing."""
        columns: dict[str, Any] = {**plain, **scores}
        return cls(statuses, columns.__getitem__, scores)

    @cached_property
    def score_names(self) -> list[str]:
        """Names of the scores that at least one replicate has."""
        return [name for name in self._names if not np.all(np.isnan(self._column(name)))]

    def scores(self, name: str) -> np.ndarray:
        """Return a score (n,), NaN where missing."""
        return np.array(self._column(name), float) if name in self._names else np.full(len(self), np.nan)

    def numbers(self, name: str) -> np.ndarray:
        """Return a column of :data:`NUMBERS`, or ``evaluations``, as an array (n,)."""
        return np.array(self._column(name), float)

    def plain(self, name: str) -> list[Any]:
        """Return a column of :data:`PLAIN` as a list."""
        return self.numbers(name).tolist() if name in NUMBERS else list(self._column(name))

    def __reduce__(self) -> tuple[Any, ...]:
        scores = {name: self.scores(name) for name in self.score_names}
        return Rows.from_columns, (self.statuses, {name: self.plain(name) for name in PLAIN}, scores)

    def take(self, indices: Iterable[int]) -> Rows:
        """Return the replicates at these indices, in this order."""
        indices = list(indices)
        statuses, plain, scores = self.__reduce__()[1]
        columns = {name: [column[i] for i in indices] for name, column in plain.items()}
        selected = {name: values[indices] for name, values in scores.items()}
        return Rows.from_columns([statuses[i] for i in indices], columns, selected)

    def sorted(self) -> Rows:
        """Return the replicates in the order of their number."""
        return self.take(np.argsort(self.plain("replicate")))

    def __add__(self, other: Rows) -> Rows:
        plain = {name: self.plain(name) + other.plain(name) for name in PLAIN}
        names = dict.fromkeys([*self.score_names, *other.score_names])
        scores = {name: np.concatenate([self.scores(name), other.scores(name)]) for name in names}
        return Rows.from_columns(self.statuses + other.statuses, plain, scores)

    @cached_property
    def _rows(self) -> tuple[Row, ...]:
        scores = {name: self.scores(name).tolist() for name in self.score_names}
        plain = {name: self.plain(name) for name in PLAIN}
        return tuple(
            Row(
                status=status,
                scores={name: values[i] for name, values in scores.items() if not math.isnan(values[i])},
                **{name: values[i] for name, values in plain.items()},
            )
            for i, status in enumerate(self.statuses)
        )

    def __getitem__(self, index: Any) -> Any:
        return self._rows[index]

    def __len__(self) -> int:
        return len(self.statuses)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and tuple(self) == tuple(other)

    def __repr__(self) -> str:
        return repr(self._rows)


def score_columns(scores: Sequence[Mapping[str, float]]) -> dict[str, np.ndarray]:
    """Convert the scores of each replicate to columns (n,), NaN where missing, in order of first appearance."""
    names = dict.fromkeys(name for replicate in scores for name in replicate)
    return {name: np.array([replicate.get(name, math.nan) for replicate in scores], float) for name in names}
