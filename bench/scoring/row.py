"""The replicates of a cell: what became of each, its scores, and what it took; by column, and one by one."""

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

    ``wall_s`` and ``cpu_s`` are those of the fit alone, ``peak_memory_mb`` by how much its process grew. A fit that ran
    out of time has the scores of the best parameters it had reported, if any, and status ``timeout``. ``data`` is a
    digest of the samples, forces and prior that the method was given: equal where two methods met the same data.
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
"""What a row has beside its status and its scores."""

STATISTICS = ("mean", "median", "ci_low", "ci_high", "bound", "excess", "n_ok")
"""What is stated of a metric over the replicates. Failed ones count as infinite errors in mean, median and interval.

``excess`` is the root mean square over the successful replicates divided by ``bound`` (1 is the best an unbiased method
can do); for a coverage, mean and interval are of the fraction (Wilson's interval), over the successful; for a level at
the truth (``_pit``) and a share of the record, they are of the mean, likewise.
"""


class Rows(Sequence[Row]):
    """Replicates by column, so that a score of all of them is read without making any row.

    ``column`` returns a column of :data:`PLAIN`, or one of the scores ``score_names``, (n,), NaN where there is none.
    """

    def __init__(
        self, statuses: Iterable[Status], column: Callable[[str], Sequence[Any]], score_names: Collection[str]
    ) -> None:
        self.statuses, self._column, self._names = tuple(statuses), column, score_names

    @classmethod
    def of(cls, rows: Iterable[Row]) -> Rows:
        """Return the rows by column."""
        if isinstance(rows, Rows):
            return rows
        rows = tuple(rows)
        plain = {name: [getattr(row, name) for row in rows] for name in PLAIN}
        return cls.of_columns([row.status for row in rows], plain, columns_of([row.scores for row in rows]))

    @classmethod
    def of_columns(
        cls, statuses: Iterable[Status], plain: Mapping[str, Sequence[Any]], scores: Mapping[str, np.ndarray]
    ) -> Rows:
        """Return the rows of all columns of :data:`PLAIN`, and of scores (n,), NaN where a replicate has none."""
        columns: dict[str, Any] = {**plain, **scores}
        return cls(statuses, columns.__getitem__, scores)

    @cached_property
    def score_names(self) -> list[str]:
        """The scores that any replicate has."""
        return [name for name in self._names if not np.all(np.isnan(self._column(name)))]

    def scores(self, name: str) -> np.ndarray:
        """Return a score (n,), NaN where a replicate has none."""
        return np.array(self._column(name), float) if name in self._names else np.full(len(self), np.nan)

    def numbers(self, name: str) -> np.ndarray:
        """Return a number of each fit, (n,): one of :data:`NUMBERS`, or ``evaluations``."""
        return np.array(self._column(name), float)

    def plain(self, name: str) -> list[Any]:
        """Return a column of :data:`PLAIN`, such as the ``message`` of each replicate."""
        return self.numbers(name).tolist() if name in NUMBERS else list(self._column(name))

    def __reduce__(self) -> tuple[Any, ...]:
        scores = {name: self.scores(name) for name in self.score_names}
        return Rows.of_columns, (self.statuses, {name: self.plain(name) for name in PLAIN}, scores)

    def take(self, places: Iterable[int]) -> Rows:
        """Return the replicates at some places, in that order."""
        places = list(places)
        statuses, plain, scores = self.__reduce__()[1]
        columns = {name: [column[i] for i in places] for name, column in plain.items()}
        picked = {name: values[places] for name, values in scores.items()}
        return Rows.of_columns([statuses[i] for i in places], columns, picked)

    def sorted(self) -> Rows:
        """Return the replicates in the order of their numbers."""
        return self.take(np.argsort(self.plain("replicate")))

    def __add__(self, other: Rows) -> Rows:
        plain = {name: self.plain(name) + other.plain(name) for name in PLAIN}
        names = dict.fromkeys([*self.score_names, *other.score_names])
        scores = {name: np.concatenate([self.scores(name), other.scores(name)]) for name in names}
        return Rows.of_columns(self.statuses + other.statuses, plain, scores)

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

    def __getitem__(self, place: Any) -> Any:
        return self._rows[place]

    def __len__(self) -> int:
        return len(self.statuses)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and tuple(self) == tuple(other)

    def __repr__(self) -> str:
        return repr(self._rows)


def columns_of(scores: Sequence[Mapping[str, float]]) -> dict[str, np.ndarray]:
    """Return the scores of replicates by name, (n,), NaN where one has none; in the order in which they have them."""
    names = dict.fromkeys(name for replicate in scores for name in replicate)
    return {name: np.array([replicate.get(name, math.nan) for replicate in scores], float) for name in names}
