"""The published archive: plain Parquet files and the list of their checksums, read here, never written.

``cells.parquet`` has a line per cell, ``rows/<experiment>.parquet`` a line per replicate and a column per score,
``summaries.parquet`` a line per cell and metric, ``arrays.parquet`` a line per array of a cell's first replicate,
``bounds.parquet`` a line per bound; ``docs/reference/file_formats.md`` lists the columns. Within every file the cells
stand in the order of ``cells.parquet``. A file is compared with its checksum when a process first reads it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.contract.estimate import Status
from bench.errors import InputError
from bench.scoring.row import Row
from bench.store.checksums import REMEDY, checked, read_sums
from bench.store.columns import Columns
from bench.store.digits import decimal
from bench.store.stored import Head, StoredCell
from bench.store.version import NUMBERS

if TYPE_CHECKING:  # pyarrow is loaded when a file is read
    import pyarrow as pa

CELLS, SUMMARIES, ARRAYS, BOUNDS = "cells.parquet", "summaries.parquet", "arrays.parquet", "bounds.parquet"
STATISTICS = ("mean", "median", "ci_low", "ci_high", "bound", "excess", "n_ok")
NUMBERS_OF_FIT = ("wall_s", "cpu_s", "peak_memory_mb")
PLAIN = ("identity", "replicate", "status", "message", "data", "evaluations", *NUMBERS_OF_FIT)
"""The columns of a file of rows that are no scores."""
JSON = ("description", "statuses", "prior_share", "identifiable", "provenance")
"""The columns of ``cells.parquet`` that hold JSON."""


def rows_file(experiment: str) -> str:
    """Return the name of the file with the rows of an experiment's cells."""
    return f"rows/{experiment}.parquet"


class ParquetFile:
    """A whole file of the archive, of which columns are read when they are first needed."""

    def __init__(self, folder: Path, name: str, sums: Mapping[str, str]) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        self.path = folder / name
        content = checked(folder, name, sums)
        try:
            self._file = pq.ParquetFile(pa.BufferReader(content))
            self.names = dict.fromkeys(self._file.schema_arrow.names)
        except (pa.ArrowException, OSError, ValueError):
            raise InputError("archive", self.path, REMEDY) from None
        self._numbers: dict[str, np.ndarray] = {}
        self._lists: dict[str, list[Any]] = {}

    def column(self, name: str) -> pa.Array:
        """Return a column; raises InputError where the file has none of that name."""
        import pyarrow as pa

        try:
            return self._file.read([name]).column(name).combine_chunks()
        except (pa.ArrowException, OSError, ValueError, KeyError):
            raise InputError("archive", self.path, f"{REMEDY} (it has no column {name})") from None

    def numbers(self, name: str) -> np.ndarray:
        """Return a column of numbers in double precision, NaN where it is empty."""
        if name not in self._numbers:
            self._numbers[name] = decimal(self.column(name).to_numpy(zero_copy_only=False).astype(float))
        return self._numbers[name]

    def items(self, name: str) -> list[Any]:
        """Return a column as a list, of which equal texts are one object."""
        if name not in self._lists:
            column = self.column(name)
            if str(column.type) in ("string", "large_string"):
                coded = column.dictionary_encode()
                words = coded.dictionary.to_pylist()
                self._lists[name] = [None if i is None else words[i] for i in coded.indices.to_pylist()]
            else:
                self._lists[name] = column.to_pylist()
        return self._lists[name]


class ArchivedRows(Columns):
    """The rows of a cell: a range of lines of a file."""

    def __init__(self, file: ParquetFile, lines: slice) -> None:
        self._file, self._lines = file, lines

    def __len__(self) -> int:
        return int(self._lines.stop - self._lines.start)

    @cached_property
    def statuses(self) -> tuple[Status, ...]:
        known = {status.value: status for status in Status}
        return tuple(known[text] for text in self._file.items("status")[self._lines])

    @cached_property
    def score_names(self) -> list[str]:
        return [name for name in self._file.names if name not in PLAIN and not np.all(np.isnan(self.scores(name)))]

    def scores(self, name: str) -> np.ndarray:
        if name not in self._file.names or name in PLAIN:
            return np.full(len(self), math.nan)
        return self._file.numbers(name)[self._lines].copy()

    def numbers(self, name: str) -> np.ndarray:
        return self._file.numbers(name)[self._lines].copy()

    def texts(self, name: str) -> list[str]:
        return self._file.items(name)[self._lines]

    @cached_property
    def _rows(self) -> tuple[Row, ...]:
        scores = {name: self.scores(name).tolist() for name in self.score_names}
        replicates, evaluations = (self._file.items(name)[self._lines] for name in ("replicate", "evaluations"))
        wall, cpu, memory = (self.numbers(name).tolist() for name in NUMBERS_OF_FIT)
        messages, data = self.texts("message"), self.texts("data")
        return tuple(
            Row(
                replicate=replicates[i],
                status=status,
                message=messages[i],
                scores={name: values[i] for name, values in scores.items() if not math.isnan(values[i])},
                wall_s=wall[i],
                cpu_s=cpu[i],
                peak_memory_mb=memory[i],
                evaluations=evaluations[i],
                data=data[i],
            )
            for i, status in enumerate(self.statuses)
        )

    def __reduce__(self) -> tuple[Any, ...]:
        return tuple, (self._rows,)


class ArchivedSummary(Mapping[str, Mapping[str, float]]):
    """The summary of a cell by metric: a range of lines of ``summaries.parquet``."""

    def __init__(self, file: ParquetFile, lines: slice) -> None:
        self._file, self._lines = file, lines
        self._read: dict[str, Mapping[str, float]] = {}

    @cached_property
    def _places(self) -> dict[str, int]:
        return {name: self._lines.start + i for i, name in enumerate(self._file.items("metric")[self._lines])}

    def __getitem__(self, metric: str) -> Mapping[str, float]:
        if metric not in self._read:
            place = self._places[metric]
            self._read[metric] = {name: float(self._file.numbers(name)[place]) for name in STATISTICS}
        return self._read[metric]

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)

    def __repr__(self) -> str:
        return repr(dict(self))

    def __reduce__(self) -> tuple[Any, ...]:
        return dict, (dict(self),)


class Archive:
    """A folder of the archive's files. What is not there is an empty archive."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._opened: dict[str, ParquetFile] = {}

    def __reduce__(self) -> tuple[object, ...]:
        return Archive, (self.folder,)

    @cached_property
    def _sums(self) -> dict[str, str]:
        return read_sums(self.folder)

    def file(self, name: str) -> ParquetFile:
        """Return one of the archive's files; raises InputError where it is damaged."""
        if name not in self._opened:
            self._opened[name] = ParquetFile(self.folder, name, self._sums)
        return self._opened[name]

    @cached_property
    def _places(self) -> dict[str, int]:
        """The line of each cell in ``cells.parquet``."""
        if not self._sums:
            if any(self.folder.glob("*.parquet")):
                raise InputError("archive", self.folder, f"its SHA256SUMS is missing; {REMEDY}")
            return {}
        return {identity: i for i, identity in enumerate(self.file(CELLS).items("identity"))}

    @cached_property
    def _row_lines(self) -> list[slice]:
        """The lines of each cell in its file of rows."""
        ends: dict[str, int] = {}
        lines = []
        for experiment, n in zip(self._of("experiment"), self._of("replicates"), strict=True):
            start = ends.get(experiment, 0)
            ends[experiment] = start + n
            lines.append(slice(start, start + n))
        return lines

    @cached_property
    def _summary_lines(self) -> list[slice]:
        """The lines of each cell in ``summaries.parquet``."""
        ends = np.cumsum(self._of("metrics")).tolist()
        return [slice(start, end) for start, end in zip([0, *ends], ends, strict=False)]

    def _of(self, column: str) -> list[Any]:
        return self.file(CELLS).items(column)

    def identities(self) -> list[str]:
        """Return the identities of all cells, in order."""
        return sorted(self._places)

    def __contains__(self, identity: object) -> bool:
        return identity in self._places

    def path(self, identity: str) -> Path:
        """Return the file that holds the rows of a cell."""
        return self.folder / rows_file(self._of("experiment")[self._places[identity]])

    def experiment(self, identity: str) -> str:
        """Return the experiment whose file holds the rows of a cell."""
        return str(self._of("experiment")[self._places[identity]])

    def head(self, identity: str) -> Head | None:
        """Return what is known of a cell without its rows, or None."""
        place = self._places.get(identity)
        if place is None:
            return None
        return Head(
            identity=identity,
            cell=self._json("description", place),
            statuses=self._json("statuses", place),
            version=self._version(place),
            wall_s=self._of("wall_s")[place],
        )

    def load(self, identity: str) -> StoredCell | None:
        """Return a cell, or None where the archive has none of that name; its rows are read when they are used."""
        place = self._places.get(identity)
        if place is None:
            return None
        return StoredCell(
            identity=identity,
            cell=self._json("description", place),
            rows=ArchivedRows(self.file(rows_file(self._of("experiment")[place])), self._row_lines[place]),
            summary=ArchivedSummary(self.file(SUMMARIES), self._summary_lines[place]),
            prior_share={name: float(value) for name, value in self._json("prior_share", place).items()},
            identifiable=self._json("identifiable", place),
            wall_s=self._of("wall_s")[place],
            provenance=self._json("provenance", place),
            version=self._version(place),
            arrays=ARRAYS if self._of("arrays")[place] else "",
        )

    def _json(self, column: str, place: int) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(self._of(column)[place])
        return found

    def _version(self, place: int) -> dict[str, Any]:
        return {name: self._of(f"{name}_version")[place] for name in NUMBERS}

    def tracebacks(self, identity: str) -> str:
        """Return the tracebacks of a cell's failed replicates, or nothing."""
        return str(self._of("tracebacks")[self._places[identity]]) if identity in self._places else ""

    @cached_property
    def _array_lines(self) -> dict[str, dict[str, int]]:
        """The line of each array, by cell and name."""
        lines: dict[str, dict[str, int]] = {}
        file = self.file(ARRAYS)
        for i, (identity, name) in enumerate(zip(file.items("identity"), file.items("name"), strict=True)):
            lines.setdefault(identity, {})[name] = i
        return lines

    def arrays(self, identity: str) -> dict[str, np.ndarray]:
        """Return the arrays kept of a cell's first replicate; none where the archive has none."""
        return {name: self._array(line) for name, line in self._array_lines.get(identity, {}).items()}

    def _array(self, line: int) -> np.ndarray:
        file = self.file(ARRAYS)
        name, same_as = file.items("name")[line], file.items("same_as")[line]
        holder = self._array_lines[same_as][name] if same_as else line
        values = self._array_values[holder].values.to_numpy(zero_copy_only=False)
        kind = np.int64 if file.items("whole")[line] else np.float32
        return values.astype(kind).reshape(file.items("shape")[line])

    @cached_property
    def _array_values(self) -> pa.Array:
        return self.file(ARRAYS).column("values")

    def bounds(self) -> dict[str, str]:
        """Return the texts of all bounds by identity; raises InputError where their file is damaged."""
        if not self._sums:
            return {}
        file = self.file(BOUNDS)
        return dict(zip(file.items("identity"), file.items("text"), strict=True))
