"""The rows of a cell by column, so that a table reads a score of all replicates without making any row."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from functools import cached_property
from typing import overload

import numpy as np

from bench.contract.estimate import Status
from bench.scoring.row import Row, score_columns


class Columns(Sequence[Row]):
    """The rows of a cell, equal to a tuple of the same rows."""

    @property
    @abstractmethod
    def statuses(self) -> tuple[Status, ...]:
        """The status of each replicate."""

    @property
    @abstractmethod
    def score_names(self) -> list[str]:
        """The scores that any replicate has."""

    @abstractmethod
    def scores(self, name: str) -> np.ndarray:
        """Return a score (n,), NaN where a replicate has none."""

    @abstractmethod
    def numbers(self, name: str) -> np.ndarray:
        """Return a number of each fit, (n,): ``wall_s``, ``cpu_s``, ``peak_memory_mb``, ``evaluations``."""

    @abstractmethod
    def texts(self, name: str) -> list[str]:
        """Return the ``message`` or the digest of the ``data`` of each replicate."""

    @property
    @abstractmethod
    def _rows(self) -> tuple[Row, ...]: ...

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

    @property
    def score_names(self) -> list[str]:
        return list(self._scores)

    def scores(self, name: str) -> np.ndarray:
        return self._scores[name] if name in self._scores else np.full(len(self._made), math.nan)

    @cached_property
    def _scores(self) -> dict[str, np.ndarray]:
        return score_columns(self._made)

    def numbers(self, name: str) -> np.ndarray:
        return np.array([getattr(row, name) for row in self._rows], float)

    def texts(self, name: str) -> list[str]:
        return [getattr(row, name) for row in self._rows]
