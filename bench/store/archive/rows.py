"""The rows of a cell of the archive: a row, or a column of numbers, is made when it is asked for."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from bench.contract.estimate import Status
from bench.scoring.row import Row
from bench.store.archive.decimals import MISSING, from_codes
from bench.store.archive.scores import FAMILIES, Unpacked
from bench.store.columns import Columns

NUMBERS = ("row_wall_s", "row_cpu_s", "row_peak_memory_mb")
TEXTS = ("row_replicate", "row_message", "row_data", "row_evaluations")
SCORES = ("scores", "dof", "above", "unsure", *(f"score_{name}" for name in FAMILIES))
Line = Callable[[Sequence[str]], Mapping[str, Any]]
"""Some columns of the line that holds a cell."""


class PackedRows(Columns):
    """The rows of the cell of a line."""

    def __init__(self, line: Line) -> None:
        self._line = line

    def __len__(self) -> int:
        return len(self.statuses)

    @cached_property
    def statuses(self) -> tuple[Status, ...]:
        known = {status.value: status for status in Status}
        return tuple(known[text] for text in self._line(("row_status",))["row_status"])

    def scores(self, name: str) -> np.ndarray:
        found = np.full(len(self), math.nan)
        if name in self._unpacked.row:
            found[self._scored] = self._unpacked.numbers_of(name)
        return found

    @property
    def all_scores(self) -> dict[str, list[float | None]]:
        codes, found = self._unpacked.codes, np.full((len(self._unpacked.names), len(self)), None, object)
        values = from_codes(codes).astype(object)
        values[codes == MISSING] = None
        found[:, self._scored] = values
        return dict(zip(self._unpacked.names, found.tolist(), strict=True))

    @property
    def cpu_s(self) -> np.ndarray:
        return from_codes(np.asarray(self._line(("row_cpu_s",))["row_cpu_s"]))

    @cached_property
    def _scored(self) -> np.ndarray:
        return np.asarray(self._line(("row_scored",))["row_scored"], bool)

    @cached_property
    def _unpacked(self) -> Unpacked:
        line = self._line(SCORES)
        packed = {name: line[f"score_{name}"] for name in FAMILIES}
        names = line["scores"].split(" ") if line["scores"] else []
        others = {name: line[name] for name in ("above", "unsure", "dof")}
        return Unpacked(names, int(np.sum(self._scored)), packed | others)

    @cached_property
    def by_row(self) -> list[dict[str, float]]:
        """The scores of every row that has any."""
        names, codes = self._unpacked.names, self._unpacked.codes
        there = codes != MISSING
        values = zip(from_codes(codes).T.tolist(), there.T.tolist(), strict=True)
        if np.all(there):
            return [dict(zip(names, row, strict=True)) for row, _ in values]
        return [{name: v for name, v, own in zip(names, row, known, strict=True) if own} for row, known in values]

    @cached_property
    def _rows(self) -> tuple[Row, ...]:
        line = self._line((*TEXTS, *NUMBERS))
        numbers = [from_codes(np.asarray(line[name])).tolist() for name in NUMBERS]
        places = (np.cumsum(self._scored) - 1).tolist()
        return tuple(
            Row(
                int(index), status, text, RowScores(self, i) if there else {}, wall, cpu, memory, int(evaluations), data
            )
            for index, text, data, evaluations, status, there, i, wall, cpu, memory in zip(
                *(line[name] for name in TEXTS), self.statuses, self._scored.tolist(), places, *numbers, strict=True
            )
        )

    def __iter__(self) -> Iterator[Row]:
        return iter(self._rows)

    def __reduce__(self) -> tuple[Any, ...]:
        return tuple, (self._rows,)


class RowScores(Mapping[str, float]):
    """The scores of one row; a copy that is pickled is a plain dictionary."""

    def __init__(self, rows: PackedRows, place: int) -> None:
        self._rows, self._place = rows, place

    def __getitem__(self, name: str) -> float:
        return self._rows.by_row[self._place][name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._rows.by_row[self._place])

    def __len__(self) -> int:
        return len(self._rows.by_row[self._place])

    def __repr__(self) -> str:
        return repr(self._rows.by_row[self._place])

    def __reduce__(self) -> tuple[Any, ...]:
        return dict, (self._rows.by_row[self._place],)
