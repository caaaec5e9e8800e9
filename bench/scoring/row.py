"""The replicates of a cell: what became of each, its scores, and what it took; by column, and one by one."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, overload

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
    """Replicates by column, so that a table reads a score of all of them without making any row.

    Args:
        statuses: The status of each replicate.
        column: Returns a column of :data:`PLAIN`, or a score (n,), NaN where a replicate has none.
        score_names: The scores that some replicate may have.
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
        columns: dict[str, Any] = {name: [getattr(row, name) for row in rows] for name in PLAIN}
        scores = score_columns(rows)
        made = cls((row.status for row in rows), (columns | scores).__getitem__, scores)
        made._rows = rows
        return made

    @cached_property
    def score_names(self) -> list[str]:
        """The scores that any replicate has."""
        return [name for name in self._names if not np.all(np.isnan(self._column(name)))]

    def scores(self, name: str) -> np.ndarray:
        """Return a score (n,), NaN where a replicate has none."""
        return np.array(self._column(name), float) if name in self._names else np.full(len(self), np.nan)

    def numbers(self, name: str) -> np.ndarray:
        """Return a number of each fit, (n,): ``wall_s``, ``cpu_s``, ``peak_memory_mb``, ``evaluations``."""
        return np.array(self._column(name), float)

    def texts(self, name: str) -> list[str]:
        """Return the ``message`` of each replicate, or the digest of its ``data``."""
        return list(self._column(name))

    @cached_property
    def _rows(self) -> tuple[Row, ...]:
        scores = {name: self.scores(name).tolist() for name in self.score_names}
        plain = {name: np.asarray(self._column(name)).tolist() if name in NUMBERS else self._column(name)
                 for name in PLAIN}  # fmt: skip
        return tuple(
            Row(
                status=status,
                scores={name: values[i] for name, values in scores.items() if not math.isnan(values[i])},
                **{name: values[i] for name, values in plain.items()},
            )
            for i, status in enumerate(self.statuses)
        )

    @overload
    def __getitem__(self, place: int) -> Row: ...
    @overload
    def __getitem__(self, place: slice) -> tuple[Row, ...]: ...
    def __getitem__(self, place: int | slice) -> Row | tuple[Row, ...]:
        return self._rows[place]

    def __len__(self) -> int:
        return len(self.statuses)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and tuple(self) == tuple(other)

    def __hash__(self) -> int:
        return hash(self._rows)

    def __repr__(self) -> str:
        return repr(self._rows)

    def __reduce__(self) -> tuple[Any, ...]:
        return Rows.of, (self._rows,)


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
