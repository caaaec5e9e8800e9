"""The store: one JSON file a cell, written whole or not at all, named by the hash of what it computes."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.errors import InputError
from bench.estimate import Status

FORMAT = 1
DIGITS = 6


@dataclass(frozen=True)
class Row:
    """One replicate of one cell: what became of it, its scores, and what it took.

    ``wall_s`` and ``cpu_s`` are those of the fit alone, ``peak_memory_mb`` the peak of the process that did it.
    """

    replicate: int
    status: Status
    message: str = ""
    scores: Mapping[str, float] = field(default_factory=dict)
    wall_s: float = math.nan
    cpu_s: float = math.nan
    peak_memory_mb: float = math.nan
    evaluations: int = 0


@dataclass(frozen=True)
class StoredCell:
    """What a cell's file holds: its full description, its rows, and the summary of every metric."""

    identity: str
    cell: dict[str, Any]
    rows: tuple[Row, ...]
    summary: dict[str, dict[str, float]]
    prior_share: dict[str, float]
    identifiable: dict[str, bool]
    wall_s: float
    provenance: dict[str, Any]

    @property
    def n_ok(self) -> int:
        return sum(row.status is Status.OK for row in self.rows)

    @property
    def status(self) -> Status:
        """``ok`` where any replicate succeeded, else the most frequent failure."""
        statuses = [row.status for row in self.rows]
        return Status.OK if Status.OK in statuses else max(set(statuses), key=statuses.count)


def _to_json(value: Any, digits: int = DIGITS) -> Any:
    """JSON has no infinity: numbers that are not finite become strings, the others keep so many digits."""
    if isinstance(value, float):
        return float(f"{value:.{digits}g}") if math.isfinite(value) else str(value)
    if isinstance(value, Mapping):
        return {key: _to_json(item, digits) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_to_json(item, digits) for item in value]
    return value


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)


def _columns(rows: Sequence[Row]) -> dict[str, Any]:
    """Rows as columns: smaller files, and one list a metric (null where a replicate lacks it)."""
    names = list(dict.fromkeys(name for row in rows for name in row.scores))
    plain = ("replicate", "message", "wall_s", "cpu_s", "peak_memory_mb", "evaluations")
    return {
        "status": [row.status.value for row in rows],
        **{key: [getattr(row, key) for row in rows] for key in plain},
        "scores": {name: [row.scores.get(name) for row in rows] for name in names},
    }


def _rows(columns: Mapping[str, Any]) -> tuple[Row, ...]:
    scores = columns["scores"]
    return tuple(
        Row(
            replicate=columns["replicate"][i],
            status=Status(status),
            message=columns["message"][i],
            scores={name: _number(values[i]) for name, values in scores.items() if values[i] is not None},
            wall_s=_number(columns["wall_s"][i]),
            cpu_s=_number(columns["cpu_s"][i]),
            peak_memory_mb=_number(columns["peak_memory_mb"][i]),
            evaluations=columns["evaluations"][i],
        )
        for i, status in enumerate(columns["status"])
    )


class Store:
    """A folder with one ``<identity>.json`` a cell; bounds lie in a folder beside them, under another ending."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @property
    def bounds(self) -> Path:
        return self.folder / "bounds"

    def prepare(self) -> None:
        """Make the folder and check that it can be written; raises InputError before anything runs."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            probe = self.folder / f".write-test.{os.getpid()}"
            probe.write_bytes(b"")
            probe.unlink()
        except OSError as error:
            reason = f"cannot be written ({error.strerror}); name another folder"
            raise InputError("store", self.folder, reason) from None

    def path(self, identity: str) -> Path:
        return self.folder / f"{identity}.json"

    def load(self, identity: str) -> StoredCell | None:
        """The stored cell, or None; a damaged or foreign file raises InputError and is left alone."""
        path = self.path(identity)
        return self._read(path) if path.exists() else None

    def save(self, cell: StoredCell) -> None:
        """Write a cell whole: to a temporary file, flushed to disk, then renamed."""
        content = {
            "format": FORMAT,
            "identity": cell.identity,
            "cell": cell.cell,
            "status": cell.status.value,
            "n_ok": cell.n_ok,
            "n": len(cell.rows),
            "wall_s": cell.wall_s,
            "summary": cell.summary,
            "prior_share": cell.prior_share,
            "identifiable": cell.identifiable,
            "provenance": cell.provenance,
            "rows": _columns(cell.rows),
        }
        path = self.path(cell.identity)
        temporary = path.with_suffix(f".{os.getpid()}.tmp")
        with temporary.open("w", encoding="utf-8") as file:
            exact = _to_json(cell.cell, 17)  # what was computed, as opposed to what came out, is kept to the last digit
            json.dump({**_to_json(content), "cell": exact}, file, ensure_ascii=False, separators=(",", ":"))
            file.write("\n")
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)

    def __iter__(self) -> Iterator[StoredCell]:
        for path in sorted(self.folder.glob("*.json")):
            yield self._read(path)

    def _read(self, path: Path) -> StoredCell:
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            if content["format"] != FORMAT:
                remedy = f"format {content['format']}, this version reads {FORMAT}; move it away"
                raise InputError("store", path, remedy)
            if content["identity"] != path.stem:
                raise InputError("store", path, f"it holds the cell {content['identity']}; move it away")
            return StoredCell(
                identity=content["identity"],
                cell=content["cell"],
                rows=_rows(content["rows"]),
                summary={m: {k: _number(v) for k, v in s.items()} for m, s in content["summary"].items()},
                prior_share={k: _number(v) for k, v in content["prior_share"].items()},
                identifiable=content["identifiable"],
                wall_s=_number(content["wall_s"]),
                provenance=content["provenance"],
            )
        except InputError:
            raise
        except (OSError, ValueError, KeyError, TypeError, IndexError, AttributeError):
            raise InputError("store", path, "not a whole cell of this benchmark; move it away and run again") from None
