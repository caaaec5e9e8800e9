"""What is stored of a cell, and its form as a file of JSON and one of arrays.

The file of JSON is sealed (:mod:`bench.store.seal`), and names the files of arrays and of tracebacks beside it, each
with the digest of its bytes.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import re
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from bench.contract.estimate import Status
from bench.scoring.row import Row
from bench.store.archive.decimals import from_codes, to_codes
from bench.store.columns import Columns, MadeRows
from bench.store.seal import Unsealed, sealed, unsealed
from bench.store.shape import is_cell

FORMAT = 3
WITHOUT_SEAL = 2
"""The format before: the same content without a seal, which :mod:`bench.store.older` takes in when it is asked to."""
DIGITS = 6
BESIDE_DIGITS = 16
"""Of the digest in the name of a file beside the cell's."""
MOST_ARRAYS = 2**29
"""Bytes of all arrays of a cell."""
ARRAYS, ERRORS = "npz", "errors.txt"
"""How the names of files beside the cell's end."""
PLAIN = ("replicate", "message", "wall_s", "cpu_s", "peak_memory_mb", "evaluations", "data")


@dataclass(frozen=True)
class StoredCell:
    """What a cell's file holds: its full description, its rows, the summary of every metric, and whence they come.

    ``wall_s`` is the time of all fits together, ``version`` what computed it, ``arrays`` and ``errors`` (tracebacks)
    the files beside it. A cell that was stored before tracebacks had a checksum names none, though it may have some.
    """

    identity: str
    cell: dict[str, Any]
    rows: Sequence[Row]
    summary: dict[str, dict[str, float]]
    prior_share: dict[str, float]
    identifiable: dict[str, bool]
    wall_s: float
    provenance: dict[str, Any] = field(default_factory=dict)
    version: dict[str, Any] = field(default_factory=dict)
    arrays: str = ""
    errors: str = ""

    @cached_property
    def columns(self) -> Columns:
        """The rows by column."""
        return self.rows if isinstance(self.rows, Columns) else MadeRows(self.rows)

    @property
    def n_ok(self) -> int:
        return self.columns.statuses.count(Status.OK)

    @property
    def status(self) -> Status:
        """``ok`` where any replicate succeeded, else the most frequent failure."""
        statuses = self.columns.statuses
        return Status.OK if Status.OK in statuses else max(set(statuses), key=statuses.count)


def to_json(value: Any, digits: int = DIGITS) -> Any:
    """JSON has no infinity: numbers that are not finite become strings, the others keep so many digits."""
    if isinstance(value, float):
        return float(f"{value:.{digits}g}") if math.isfinite(value) else str(value)
    if isinstance(value, Mapping):
        return {key: to_json(item, digits) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_json(item, digits) for item in value]
    return value


def _is_beside(name: object, identity: str, ending: str) -> bool:
    """Whether it names nothing, or a file beside the cell that is the cell's own: never one of another folder."""
    own = re.escape(identity) + r"\.[0-9a-f]{8,64}\." + re.escape(ending)
    return name == "" or (isinstance(name, str) and re.fullmatch(own, name) is not None)


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)


def _columns(cell: StoredCell) -> dict[str, Any]:
    """Rows as columns, as JSON has them: smaller files, and one list a metric (null where a replicate lacks it)."""
    return {
        "status": [status.value for status in cell.columns.statuses],
        **{key: to_json([getattr(row, key) for row in cell.rows]) for key in PLAIN},
        "scores": _shortened(cell.columns.all_scores),
    }


def _shortened(scores: Mapping[str, Sequence[float | None]]) -> dict[str, Any]:
    """What :func:`to_json` makes of scores; that most have so few digits already is seen of all of them at once."""
    every = np.array(list(scores.values()), float)  # NaN for none
    short = np.isfinite(every) & (from_codes(to_codes(every)) == every)
    return {
        name: list(values) if all(own) else [v if fits else to_json(v) for v, fits in zip(values, own, strict=True)]
        for (name, values), own in zip(scores.items(), short.tolist(), strict=True)
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
            data=columns["data"][i],
        )
        for i, status in enumerate(columns["status"])
    )


def cell_file(cell: StoredCell) -> bytes:
    """The bytes of a cell's file."""
    content = {
        "identity": cell.identity,
        "cell": None,  # its place: it goes there to the last digit
        "status": cell.status.value,
        "n_ok": cell.n_ok,
        "n": len(cell.rows),
        "wall_s": cell.wall_s,
        "version": cell.version,
        "arrays": cell.arrays,
        "summary": cell.summary,
        "prior_share": cell.prior_share,
        "identifiable": cell.identifiable,
        "provenance": cell.provenance,
    }
    if cell.errors:
        content["errors"] = cell.errors
    exact = to_json(cell.cell, 17)  # what was computed, as opposed to what came out, is kept to the last digit
    text = json.dumps(
        {**to_json(content), "cell": exact, "rows": _columns(cell)}, ensure_ascii=False, separators=(",", ":")
    )
    return sealed(FORMAT, f"{text}\n")


def arrays_file(arrays: Mapping[str, np.ndarray]) -> bytes:
    """A compressed npz whose bytes depend on the arrays alone (the usual writer puts the time into it)."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(arrays):
            values = np.asarray(arrays[name])
            item = io.BytesIO()
            np.lib.format.write_array(item, values.astype("f4") if values.dtype == float else values)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), item.getvalue(), zipfile.ZIP_DEFLATED, 1)
    return buffer.getvalue()


def beside_name(identity: str, content: bytes, ending: str) -> str:
    """The name of a file beside a cell's: the cell's, and the beginning of the digest of its bytes; of nothing none."""
    return f"{identity}.{hashlib.sha256(content).hexdigest()[:BESIDE_DIGITS]}.{ending}" if content else ""


def check_beside(name: str, content: bytes) -> None:
    """Raise Unsealed where the bytes of a file beside a cell's are not those that its name states."""
    digits = name.removesuffix(f".{ARRAYS}").removesuffix(f".{ERRORS}").rpartition(".")[2]
    if not hashlib.sha256(content).hexdigest().startswith(digits):
        raise Unsealed("its checksum is not that of its content")


def read_arrays(name: str, content: bytes) -> dict[str, np.ndarray]:
    """The arrays of a file of that name; raises Unsealed where its bytes are not those that the name states."""
    check_beside(name, content)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            if sum(item.file_size for item in archive.infolist()) > MOST_ARRAYS:
                raise Unsealed(f"its arrays unpack to more than {MOST_ARRAYS >> 20} MB")
        with np.load(io.BytesIO(content), allow_pickle=False) as found:
            return {key: found[key] for key in found.files}
    except Unsealed:
        raise
    except Exception:  # sealed by another hand: zipfile, zlib and numpy raise a dozen kinds
        raise Unsealed("no file of arrays") from None


def cell_from_file(content: bytes) -> StoredCell:
    """The cell of a file's bytes; raises Unsealed where they are none that is sealed and whole."""
    return cell_from_json(unsealed(FORMAT, content))


def cell_from_json(content: Any) -> StoredCell:
    """The cell of a file's content; raises Unsealed where it is none."""
    names = {ARRAYS: "arrays", ERRORS: "errors"}
    if not is_cell(content) or not all(
        _is_beside(content.get(key, ""), content["identity"], ending) for ending, key in names.items()
    ):
        raise Unsealed("no cell of this benchmark")
    return StoredCell(
        identity=content["identity"],
        cell=content["cell"],
        rows=_rows(content["rows"]),
        summary={m: {k: _number(v) for k, v in s.items()} for m, s in content["summary"].items()},
        prior_share={k: _number(v) for k, v in content["prior_share"].items()},
        identifiable=content["identifiable"],
        wall_s=_number(content["wall_s"]),
        provenance=content["provenance"],
        version=content["version"],
        arrays=content["arrays"],
        errors=content.get("errors", ""),
    )
