"""The file of a stored cell: three lines, for its description, its rows, and its arrays.

The first line is JSON with a checksum (:mod:`bench.store.seal`) and states the SHA-256 of the other lines, so that it
can be read alone. The second line is JSON. The third line is an npz file in base64, or empty without arrays.
"""

from __future__ import annotations

import base64
import hashlib
import io
import json
import math
import zipfile
from collections import Counter
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from bench.contract.estimate import Status
from bench.errors import InputError
from bench.scoring.row import NUMBERS, PLAIN, Rows
from bench.store.digits import DIGITS, decimal
from bench.store.seal import Unsealed, parsed, sealed, unsealed
from bench.store.shape import HEAD, fits
from bench.store.stored_cell import Arrays, CellHead, StoredCell

FORMAT = 5
EXACT_DIGITS = 17
"""Significant digits of the numbers in a description, which are stored exactly."""
MOST_ARRAYS = 2**29
"""Largest size of the unpacked arrays of a cell (bytes)."""
FOREIGN = "not a cell of this benchmark"


def to_json(value: Any, digits: int = DIGITS) -> Any:
    """Round the numbers in a nested value; non-finite numbers, which JSON lacks, become strings."""
    if isinstance(value, float):
        return float(f"{value:.{digits}g}") if math.isfinite(value) else str(value)
    if isinstance(value, Mapping):
        return {key: to_json(item, digits) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_json(item, digits) for item in value]
    return value


def cell_file(cell: StoredCell) -> bytes:
    """Return the content of a cell's file."""
    columns = cell.columns
    statuses = [status.value for status in columns.statuses]
    rows = {"status": statuses, **{name: _plain(columns, name) for name in PLAIN}, "scores": _scores(columns)}
    body = _dumped({"summary": to_json(cell.summary), "rows": rows, "tracebacks": cell.tracebacks})
    body += b"\n" + (base64.b64encode(_packed(cell.arrays)) if cell.arrays else b"")
    head = {
        "identity": cell.identity,
        "cell": to_json(cell.cell, EXACT_DIGITS),
        "statuses": Counter(statuses),
        **to_json({key: getattr(cell, key) for key in ("wall_s", "prior_share", "identifiable", "provenance")}),
        "version": cell.version,
        "body": hashlib.sha256(body).hexdigest(),
    }
    return sealed(FORMAT, _dumped(head).decode()) + b"\n" + body


def _plain(columns: Rows, name: str) -> list[Any]:
    rounded: list[Any] = to_json(columns.numbers(name).tolist() if name in NUMBERS else columns.plain(name))
    return rounded


def _scores(columns: Rows) -> dict[str, list[Any]]:
    """Return the scores of all replicates by name; a missing score is None."""
    names = columns.score_names
    values = decimal(np.array([columns.scores(name) for name in names]))
    return {
        name: [None if math.isnan(v) else v if math.isfinite(v) else str(v) for v in column]
        for name, column in zip(names, values.tolist(), strict=True)
    }


def _dumped(content: Any) -> bytes:
    text = json.dumps(content, ensure_ascii=False, separators=(",", ":"))
    return text.encode("utf-8", "replace")  # a label may contain bytes that are not UTF-8


def head_from_line(line: bytes, stamp: int = 0) -> CellHead:
    """Return the head in a file's first line; raises Unsealed if the line is damaged."""
    head = _head(line)
    return CellHead(head["identity"], head["cell"], head["statuses"], head["version"], float(head["wall_s"]), stamp)


def _head(line: bytes) -> dict[str, Any]:
    head = unsealed(FORMAT, line.removesuffix(b"\n"))
    if not (head.keys() >= HEAD.keys() and fits(head, HEAD) and set(head["statuses"]) <= set(Status)):
        raise Unsealed(FOREIGN)
    return head


def cell_from_file(content: bytes) -> StoredCell:
    """Return the cell of a file's content; raises Unsealed if it is damaged or not a cell."""
    line, _, rest = content.partition(b"\n")
    head = _head(line)
    if hashlib.sha256(rest).hexdigest() != head["body"]:
        raise Unsealed("its checksum does not match its content")
    text, _, arrays = rest.partition(b"\n")
    body = parsed(text)
    try:
        rows = _rows(body["rows"])
        if not rows or Counter(rows.statuses) != Counter(head["statuses"]):
            raise ValueError
        return StoredCell(
            rows=rows,
            summary={name: {key: _number(value) for key, value in s.items()} for name, s in body["summary"].items()},
            prior_share={key: float(value) for key, value in head["prior_share"].items()},
            wall_s=float(head["wall_s"]),
            arrays=Arrays(partial(_unpacked, head["identity"], arrays)) if arrays else {},
            tracebacks=str(body["tracebacks"]),
            **{key: head[key] for key in ("identity", "cell", "identifiable", "provenance", "version")},
        )
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError):  # written by another program
        raise Unsealed(FOREIGN) from None


def _number(value: float | str | None) -> float:
    return math.nan if value is None else float(value)


def _rows(columns: Mapping[str, Any]) -> Rows:
    """Return the rows from a file's columns; raises KeyError, TypeError or ValueError if they are invalid."""
    plain: dict[str, Any] = {name: np.array(columns[name], np.int64).tolist() for name in ("replicate", "evaluations")}
    plain |= {name: list(map(_number, columns[name])) for name in NUMBERS}
    plain |= {name: list(map(str, columns[name])) for name in ("message", "data")}
    scores = {name: np.array(list(map(_number, values))) for name, values in columns["scores"].items()}
    if {len(column) for column in (*plain.values(), *scores.values())} != {len(columns["status"])}:
        raise ValueError
    return Rows.from_columns(map(Status, columns["status"]), plain, scores)


def _packed(arrays: Mapping[str, np.ndarray]) -> bytes:
    """Return a compressed npz file with floats in single precision; larger numbers become infinite."""
    buffer = io.BytesIO()
    with np.errstate(over="ignore"):
        single = {name: values.astype("f4") if values.dtype == float else values for name, values in arrays.items()}
    np.savez_compressed(buffer, **single)  # type: ignore[arg-type]
    return buffer.getvalue()


def _unpacked(identity: str, line: bytes) -> dict[str, np.ndarray]:
    """Return the arrays in a file's third line; raises InputError if it is invalid."""
    try:
        content = base64.b64decode(line, validate=True)
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            if sum(item.file_size for item in archive.infolist()) > MOST_ARRAYS:
                raise ValueError
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            return {key: arrays[key] for key in arrays.files}
    except Exception:  # zipfile, zlib and numpy raise many types of exceptions
        remedy = f"its arrays are invalid, or larger than {MOST_ARRAYS >> 20} MB"
        raise InputError("cell", identity, remedy) from None
