"""Rows that lie as columns: what is wanted of all of them is had without making any row."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from typing import overload

import numpy as np

from bench.contract.estimate import Status
from bench.scoring.row import Row


class Columns(Sequence[Row]):
    """The rows of a cell, equal to a tuple of the same rows."""

    @property
    @abstractmethod
    def statuses(self) -> tuple[Status, ...]:
        """What became of each."""

    @abstractmethod
    def scores(self, name: str) -> np.ndarray:
        """A score (n,), NaN where a row has none."""

    @property
    @abstractmethod
    def all_scores(self) -> dict[str, list[float | None]]:
        """Every score by row, None where a row has none."""

    @property
    @abstractmethod
    def cpu_s(self) -> np.ndarray:
        """Processor time of each fit (s), (n,)."""

    @property
    @abstractmethod
    def _rows(self) -> tuple[Row, ...]:
        """The rows themselves."""

    @overload
    def __getitem__(self, place: int) -> Row: ...
    @overload
    def __getitem__(self, place: slice) -> tuple[Row, ...]: ...
    def __getitem__(self, place: int | slice) -> Row | tuple[Row, ...]:
        return self._rows[place]

    def __len__(self) -> int:
        return len(self._rows)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and tuple(self) == tuple(other)

    def __hash__(self) -> int:
        return hash(tuple(self))


class MadeRows(Columns):
    """Rows that are there already."""

    def __init__(self, rows: Sequence[Row]) -> None:
        self._made = tuple(rows)

    @property
    def _rows(self) -> tuple[Row, ...]:
        return self._made

    @property
    def statuses(self) -> tuple[Status, ...]:
        return tuple(row.status for row in self._rows)

    def scores(self, name: str) -> np.ndarray:
        return np.array([row.scores.get(name, math.nan) for row in self._rows], float)

    @property
    def all_scores(self) -> dict[str, list[float | None]]:
        names = dict.fromkeys(name for row in self._rows for name in row.scores)
        return {name: [row.scores.get(name) for row in self._rows] for name in names}

    @property
    def cpu_s(self) -> np.ndarray:
        return np.array([row.cpu_s for row in self._rows], float)
