"""A stored cell as a file: two lines of JSON, and beside it an npz of arrays and a text of tracebacks.

The first line describes the cell, the second has its summary and its rows. The first is sealed
(:mod:`bench.store.seal`) and states the SHA-256 of the second; the names of the files beside it state their own.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import re
import zipfile
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from pydantic import ValidationError

from bench.scoring.row import Row
from bench.store.columns import Columns
from bench.store.digits import DIGITS, decimal
from bench.store.seal import Unsealed, sealed, unsealed
from bench.store.shape import BODY, HEAD
from bench.store.stored import Head, StoredCell

FORMAT = 4
EXACT_DIGITS = 17
"""A description is kept to the last digit."""
BESIDE_DIGITS = 16
"""Digits of the digest in the name of a file beside the cell's."""
MOST_ARRAYS = 2**29
"""Largest size of all arrays of a cell, in bytes."""
ARRAYS, ERRORS = "npz", "errors.txt"
"""Endings of the files beside a cell's."""
PLAIN = ("replicate", "message", "wall_s", "cpu_s", "peak_memory_mb", "evaluations", "data")


def to_json(value: Any, digits: int = DIGITS) -> Any:
    """Round the numbers of a nested value; those that are not finite, which JSON lacks, become strings."""
    if isinstance(value, float):
        return float(f"{value:.{digits}g}") if math.isfinite(value) else str(value)
    if isinstance(value, Mapping):
        return {key: to_json(item, digits) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_json(item, digits) for item in value]
    return value


def cell_file(cell: StoredCell) -> bytes:
    """Return the bytes of a cell's file."""
    columns = cell.columns
    rows = {
        "status": [status.value for status in columns.statuses],
        **{key: to_json([getattr(row, key) for row in cell.rows]) for key in PLAIN},
        "scores": _scores(columns),
    }
    body = _dumped({"summary": to_json(cell.summary), "rows": rows})
    head = {
        "identity": cell.identity,
        "cell": to_json(cell.cell, EXACT_DIGITS),
        "statuses": Counter(rows["status"]),
        **to_json({key: getattr(cell, key) for key in ("wall_s", "prior_share", "identifiable", "provenance")}),
        "version": cell.version,
        "arrays": cell.arrays,
        "errors": cell.errors,
        "body": hashlib.sha256(body).hexdigest(),
    }
    return sealed(FORMAT, _dumped(head).decode()) + b"\n" + body


def _scores(columns: Columns) -> dict[str, list[Any]]:
    """Return every score by replicate, null where a replicate has none."""
    names = columns.score_names
    values = decimal(np.array([columns.scores(name) for name in names]))
    finite = np.all(np.isfinite(values), axis=-1) if names else []
    return {
        name: own if plain else [None if math.isnan(v) else v if math.isfinite(v) else str(v) for v in own]
        for name, own, plain in zip(names, values.tolist(), finite, strict=True)
    }


def _dumped(content: Any) -> bytes:
    text = json.dumps(content, ensure_ascii=False, separators=(",", ":"))
    return text.encode("utf-8", "replace")  # a label may have been read from bytes that are no text


def head_from_line(line: bytes, stamp: int = 0) -> Head:
    """Return the head of a file's first line; raises Unsealed where that is not whole."""
    head = _head(line)
    return Head(head["identity"], head["cell"], head["statuses"], head["version"], float(head["wall_s"]), stamp)


def _head(line: bytes) -> dict[str, Any]:
    head = unsealed(FORMAT, line.removesuffix(b"\n"))
    try:
        HEAD.validate_python(head)
    except ValidationError:
        raise Unsealed("no cell of this benchmark") from None
    for ending, key in {ARRAYS: "arrays", ERRORS: "errors"}.items():
        if head[key] and not re.fullmatch(_beside(head["identity"], ending), head[key]):
            raise Unsealed("no cell of this benchmark")
    return head


def cell_from_file(content: bytes) -> StoredCell:
    """Return the cell of a file's bytes; raises Unsealed where they are none that is sealed and whole."""
    line, _, text = content.partition(b"\n")
    head = _head(line)
    if hashlib.sha256(text).hexdigest() != head["body"]:
        raise Unsealed("its checksum is not that of its content")
    try:
        body = BODY.validate_json(text)
    except (ValidationError, RecursionError):
        raise Unsealed("no cell of this benchmark") from None
    rows = body["rows"]
    lengths = {len(rows[name]) for name in ("status", *PLAIN)} | set(map(len, rows["scores"].values()))  # type: ignore[literal-required]
    if len(lengths) != 1 or 0 in lengths or Counter(rows["status"]) != Counter(head["statuses"]):
        raise Unsealed("no cell of this benchmark")
    return StoredCell(
        identity=head["identity"],
        cell=head["cell"],
        rows=_rows(rows),
        summary={name: {key: _number(value) for key, value in line.items()} for name, line in body["summary"].items()},
        prior_share={key: float(value) for key, value in head["prior_share"].items()},
        identifiable=head["identifiable"],
        wall_s=float(head["wall_s"]),
        provenance=head["provenance"],
        version=head["version"],
        arrays=head["arrays"],
        errors=head["errors"],
    )


def _number(value: float | str | None) -> float:
    return math.nan if value is None else float(value)


def _rows(columns: Mapping[str, Any]) -> Sequence[Row]:
    names, scores = list(columns["scores"]), zip(*columns["scores"].values(), strict=True)
    by_row = [{n: float(v) for n, v in zip(names, values, strict=True) if v is not None} for values in scores]
    return tuple(
        Row(
            replicate=columns["replicate"][i],
            status=status,
            message=columns["message"][i],
            scores=by_row[i] if by_row else {},
            wall_s=_number(columns["wall_s"][i]),
            cpu_s=_number(columns["cpu_s"][i]),
            peak_memory_mb=_number(columns["peak_memory_mb"][i]),
            evaluations=columns["evaluations"][i],
            data=columns["data"][i],
        )
        for i, status in enumerate(columns["status"])
    )


# ---- beside it


def arrays_file(arrays: Mapping[str, np.ndarray]) -> bytes:
    """Return a compressed npz whose bytes depend on the arrays alone (numpy's own holds the time of writing)."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(arrays):
            values = np.asarray(arrays[name])
            item = io.BytesIO()
            np.lib.format.write_array(item, values.astype("f4") if values.dtype == float else values)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), item.getvalue(), zipfile.ZIP_DEFLATED, 1)
    return buffer.getvalue()


def beside_name(identity: str, content: bytes, ending: str) -> str:
    """Return the name of a file beside a cell's: identity and digest of its bytes. An empty file has none."""
    return f"{identity}.{hashlib.sha256(content).hexdigest()[:BESIDE_DIGITS]}.{ending}" if content else ""


def _beside(identity: str, ending: str) -> str:
    return re.escape(identity) + rf"\.[0-9a-f]{{{BESIDE_DIGITS}}}\." + re.escape(ending)


def check_beside(name: str, content: bytes) -> None:
    """Raise Unsealed where the bytes of a file beside a cell's are not those that its name states."""
    ending = ARRAYS if name.endswith(ARRAYS) else ERRORS
    if beside_name(name.removesuffix(f".{ending}").rpartition(".")[0], content, ending) != name:
        raise Unsealed("its checksum is not that of its content")


def read_arrays(name: str, content: bytes) -> dict[str, np.ndarray]:
    """Return the arrays of a file of that name; raises Unsealed where its bytes are not those that the name states."""
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
