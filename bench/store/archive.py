"""Reading of the published archive: Parquet files and a list of their checksums.

``cells.parquet`` has one row per cell, ``rows/<experiment>.parquet`` one row per replicate and one column per score,
``summaries.parquet`` one row per cell and metric, ``arrays.parquet`` one row per array of a cell's first replicate, and
``bounds.parquet`` one row per bound; ``docs/reference/file_formats.md`` lists the columns. The order of cells is that
of ``cells.parquet`` in every file. The checksum of a file is verified when a process first reads it.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections import defaultdict
from collections.abc import Mapping
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.contract.estimate import Status
from bench.errors import InputError
from bench.files import read_regular
from bench.scoring.row import NUMBERS, PLAIN, STATISTICS, Rows
from bench.store import version
from bench.store.digits import decimal
from bench.store.stored_cell import Arrays, CellHead, StoredCell

if TYPE_CHECKING:  # pyarrow is loaded when a file is read
    import pyarrow as pa

SUMS = "SHA256SUMS"
"""List of the checksums of all files, in the format of ``sha256sum``."""
SUM = re.compile(r"([0-9a-f]{64})  ([a-z0-9_./]+)")
CELLS, SUMMARIES, ARRAYS, BOUNDS = "cells.parquet", "summaries.parquet", "arrays.parquet", "bounds.parquet"
NO_SCORES = frozenset(("identity", "status", *PLAIN))
"""Columns of a file of rows that are not scores."""
STATUSES = {status.value: status for status in Status}
REMEDY = "damaged or incomplete file of the archive; download it again"


def rows_file(experiment: str) -> str:
    """Return the name of the file with the replicates of an experiment's cells."""
    return f"rows/{experiment}.parquet"


def read_sums(folder: Path) -> dict[str, str]:
    """Return the checksums by file; empty if the folder has no list. Raises InputError for a damaged list."""
    path = folder / SUMS
    if not path.exists():
        return {}
    text = _read(path).decode(errors="replace")
    lines = [SUM.fullmatch(line) for line in text.split("\n")[:-1]]
    if not lines or not text.endswith("\n") or not all(lines):
        raise InputError("archive", path, REMEDY)
    return {line[2]: line[1] for line in lines if line}


def _read(path: Path) -> bytes:
    try:
        return read_regular(path)
    except OSError as error:
        raise InputError("archive", path, f"{REMEDY} ({error.strerror})") from None


class ParquetFile:
    """A file of the archive, whose checksum is verified at once and whose columns are read when first needed."""

    def __init__(self, folder: Path, name: str, sums: Mapping[str, str]) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        self.path = folder / name
        content = _read(self.path)
        if hashlib.sha256(content).hexdigest() != sums.get(name):
            raise InputError("archive", self.path, f"{REMEDY} (its checksum differs from {SUMS})")
        try:
            self._file = pq.ParquetFile(pa.BufferReader(content))
            self.names = list(self._file.schema_arrow.names)
        except (pa.ArrowException, OSError, ValueError):
            raise InputError("archive", self.path, REMEDY) from None
        self._numbers: dict[str, np.ndarray] = {}
        self._lists: dict[str, list[Any]] = {}

    def column(self, name: str) -> pa.Array:
        """Return a column; raises InputError if the file does not have it."""
        import pyarrow as pa

        try:
            return self._file.read([name]).column(name).combine_chunks()
        except (pa.ArrowException, OSError, ValueError, KeyError):
            raise InputError("archive", self.path, f"{REMEDY} (it has no column {name})") from None

    def numbers(self, name: str) -> np.ndarray:
        """Return a column of numbers in double precision; missing values are NaN."""
        if name not in self._numbers:
            column = self.column(name).cast("double")
            valid, data = column.buffers()  # pyarrow's own conversion imports pandas, which takes 0.25 s
            values = np.frombuffer(data, float, len(column)).copy()
            if valid is not None:
                bits = np.unpackbits(np.frombuffer(valid, np.uint8), count=len(column), bitorder="little")
                values[bits == 0] = math.nan
            self._numbers[name] = decimal(values)
        return self._numbers[name]

    def items(self, name: str) -> list[Any]:
        """Return a column as a list, in which equal texts are the same object."""
        if name not in self._lists:
            column = self.column(name)
            if str(column.type) in ("string", "large_string"):
                coded = column.dictionary_encode()
                words = coded.dictionary.to_pylist()
                self._lists[name] = [None if i is None else words[i] for i in coded.indices.to_pylist()]
            else:
                self._lists[name] = column.to_pylist()
        return self._lists[name]

    @cached_property
    def scores(self) -> dict[str, None]:
        """The names of the scores of a file of rows, in order."""
        return dict.fromkeys(name for name in self.names if name not in NO_SCORES)

    def part(self, name: str, rows: slice) -> Any:
        """Return a range of rows of a column of a file of rows."""
        return self.numbers(name)[rows] if name in self.scores or name in NUMBERS else self.items(name)[rows]


class Archive:
    """A published archive in a folder; a missing folder is an empty archive."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._opened: dict[str, ParquetFile] = {}

    def __reduce__(self) -> tuple[object, ...]:
        return Archive, (self.folder,)

    @cached_property
    def _sums(self) -> dict[str, str]:
        return read_sums(self.folder)

    def file(self, name: str) -> ParquetFile:
        """Return a file of the archive; raises InputError if it is damaged."""
        if name not in self._opened:
            self._opened[name] = ParquetFile(self.folder, name, self._sums)
        return self._opened[name]

    @cached_property
    def _identities(self) -> frozenset[str]:
        if not self._sums and any(self.folder.glob("*.parquet")):
            raise InputError("archive", self.folder, f"its {SUMS} is missing; {REMEDY}")
        return frozenset(self.file(CELLS).items("identity") if self._sums else ())

    @cached_property
    def _cells(self) -> dict[str, dict[str, Any]]:
        """The row of each cell in ``cells.parquet``, with its ranges in the files of rows and summaries."""
        file, cells = self.file(CELLS), {}
        ends: dict[str, int] = defaultdict(int)
        for line in zip(*map(file.items, file.names), strict=True):
            cell = dict(zip(file.names, line, strict=True))
            for part, name, n in (("rows", cell["experiment"], "replicates"), ("summary", SUMMARIES, "metrics")):
                cell[part] = slice(ends[name], ends[name] + cell[n])
                ends[name] += cell[n]
            cells[cell["identity"]] = cell
        return cells

    def identities(self) -> list[str]:
        """Return the identities of all cells, sorted."""
        return sorted(self._identities)

    def __contains__(self, identity: object) -> bool:
        return identity in self._identities

    def path(self, identity: str) -> Path:
        """Return the file with the rows of a cell."""
        return self.folder / rows_file(self._cells[identity]["experiment"])

    def head(self, identity: str) -> CellHead | None:
        """Return the head of a cell, or None if the archive does not have it."""
        if identity not in self:
            return None
        line = self._cells[identity]
        return CellHead(identity, _json(line, "description"), _json(line, "statuses"), _version(line), line["wall_s"])

    def load(self, identity: str) -> StoredCell | None:
        """Return a cell, or None if the archive does not have it; its rows are read when they are used."""
        if identity not in self:
            return None
        line = self._cells[identity]
        file, rows = self.file(rows_file(line["experiment"])), line["rows"]
        statuses = [STATUSES[text] for text in file.items("status")[rows]]
        return StoredCell(
            identity=identity,
            cell=_json(line, "description"),
            rows=Rows(statuses, partial(file.part, rows=rows), file.scores),
            summary=self._summary(line["summary"]),
            prior_share={name: float(value) for name, value in _json(line, "prior_share").items()},
            identifiable=_json(line, "identifiable"),
            wall_s=line["wall_s"],
            provenance=_json(line, "provenance"),
            version=_version(line),
            arrays=Arrays(partial(self._arrays, identity)) if line["arrays"] else {},
            tracebacks=line["tracebacks"],
        )

    @cached_property
    def _statistics(self) -> np.ndarray:
        return np.stack([self.file(SUMMARIES).numbers(name) for name in STATISTICS], axis=1)

    def _summary(self, lines: slice) -> dict[str, dict[str, float]]:
        """Return the statistics of a cell by metric."""
        metrics = self.file(SUMMARIES).items("metric")[lines]
        values = self._statistics[lines].tolist()
        return {metric: dict(zip(STATISTICS, row, strict=True)) for metric, row in zip(metrics, values, strict=True)}

    @cached_property
    def _array_lines(self) -> dict[str, dict[str, int]]:
        """The row of each array in ``arrays.parquet``, by cell and name."""
        lines: dict[str, dict[str, int]] = {}
        file = self.file(ARRAYS)
        for i, (identity, name) in enumerate(zip(file.items("identity"), file.items("name"), strict=True)):
            lines.setdefault(identity, {})[name] = i
        return lines

    @cached_property
    def _array_values(self) -> pa.Array:
        return self.file(ARRAYS).column("values")

    def _arrays(self, identity: str) -> dict[str, np.ndarray]:
        """Return the arrays of a cell; an array that equals one of an earlier cell refers to that cell."""
        file, arrays = self.file(ARRAYS), {}
        for name, line in self._array_lines.get(identity, {}).items():
            same_as = file.items("same_as")[line]
            source = self._array_lines[same_as][name] if same_as else line
            values = self._array_values[source].values.to_numpy(zero_copy_only=False)
            kind = np.int64 if file.items("whole")[line] else np.float32
            arrays[name] = values.astype(kind).reshape(file.items("shape")[line])
        return arrays

    def bounds(self) -> dict[str, str]:
        """Return the texts of all bounds by identity; raises InputError if their file is damaged."""
        if not self._sums:
            return {}
        file = self.file(BOUNDS)
        return dict(zip(file.items("identity"), file.items("text"), strict=True))


def _json(line: Mapping[str, Any], column: str) -> dict[str, Any]:
    value: dict[str, Any] = json.loads(line[column])
    return value


def _version(line: Mapping[str, Any]) -> dict[str, Any]:
    numbers = {name: line[f"{name}_version"] for name in version.NUMBERS}
    return {**numbers, **json.loads(line.get("supplied_versions") or "{}")}
