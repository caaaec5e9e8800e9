"""One file of the archive in Parquet: one line a cell, with numbers as :mod:`bench.store.archive.scores` packs them.

A cell that does not fit (a number of more digits, a name with a blank in it) is kept whole, as its file in a store is.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from bench.errors import InputError
from bench.store.archive import checked, curves, scores
from bench.store.archive.decimals import MISSING, from_codes, listed, to_codes
from bench.store.archive.rows import NUMBERS, Line, PackedRows
from bench.store.line import PLAIN, described
from bench.store.line import STATISTICS as OF_ERRORS
from bench.store.stored import StoredCell, arrays_file, cell_file, cell_from_json, to_json

CONTENT_KEY = "content"
ENDING = ".parquet"
STATISTICS = (*OF_ERRORS, "n_ok")
DESCRIBED = {
    name: kind for name, kind in PLAIN.items() if name not in ("mtime_ns", "size", "problem")
}  # fmt: skip
TEXTS = ("cell", "prior_share", "identifiable", "provenance", "computed_by", "arrays", "scores", "whole")
LISTS = {
    **{f"all_{name}": pa.int32() for name in STATISTICS},
    "row_status": pa.string(), "row_replicate": pa.int32(), "row_message": pa.string(), "row_data": pa.string(),
    "row_evaluations": pa.int64(), **{name: pa.int32() for name in NUMBERS}, "row_scored": pa.bool_(),
    **{f"score_{name}": pa.int32() for name in scores.FAMILIES}, "above": pa.bool_(), "unsure": pa.int32(),
    "array_bits": pa.int32(), "array_steps": pa.int32(), "array_finer": pa.int32(), "array_whole": pa.int64(),
}  # fmt: skip
SCHEMA = pa.schema(
    {
        **DESCRIBED, **dict.fromkeys(TEXTS, pa.string()), "tracebacks": pa.string(), "kept": pa.string(),
        "npz": pa.binary(), "dof": pa.int32(), **{name: pa.list_(kind) for name, kind in LISTS.items()},
    }
)  # fmt: skip
SUMMARY = ("metrics", *TEXTS, *(f"all_{name}" for name in STATISTICS))
ARRAYS = ("kept", "npz", *(name for name in LISTS if name.startswith("array_")))


@dataclass(frozen=True)
class Entry:
    """A cell with what lies beside it."""

    cell: StoredCell
    arrays: Mapping[str, np.ndarray]
    tracebacks: str = ""

    @cached_property
    def file(self) -> bytes:
        """The cell as its file in a store is, without a name of tracebacks: here they stand beside it."""
        return cell_file(replace(self.cell, errors=""))

    @cached_property
    def digest(self) -> str:
        """Of all that is kept of the cell."""
        pieces = [self.file, self.tracebacks.encode()]
        for name, kind, shape, content in _bits(self.arrays):
            pieces += [f"{name} {kind} {shape}".encode(), content]
        return hashlib.sha256(b"".join(hashlib.sha256(piece).digest() for piece in pieces)).hexdigest()


def content_digest(entries: Sequence[Entry]) -> str:
    """Of all that a file with these cells holds, whatever the libraries that write it."""
    found = sorted((entry.cell.identity, entry.digest) for entry in entries)
    return hashlib.sha256(json.dumps([checked.FORMAT, found]).encode()).hexdigest()


# ---- writing


def write_part(path: Path, entries: Sequence[Entry]) -> None:
    """Write a file whole, in the place of any before it; the same cells give the same bytes with the same libraries.

    Raises ValueError where a cell would not come back as it is.
    """
    ordered = sorted(entries, key=_place)
    places: dict[str, list[Any]] = {}
    table = pa.Table.from_pylist([_line(entry, places) for entry in ordered], SCHEMA)
    split = {f"{name}.list.element" for name, kind in LISTS.items() if pa.types.is_integer(kind)} - {
        "row_evaluations.list.element", "row_replicate.list.element", "array_whole.list.element"
    }  # fmt: skip
    leaves = [f"{n}.list.element" if n in LISTS else n for n in SCHEMA.names]
    booleans = {f"{n}.list.element" for n, kind in LISTS.items() if kind == pa.bool_()}
    checked.write(
        path, table, {CONTENT_KEY: content_digest(entries)},
        check=lambda written: _check(Part(written), table, ordered),
        compression="zstd", compression_level=19, write_statistics=False,
        use_dictionary=[name for name in leaves if name not in split | booleans],
        column_encoding=dict.fromkeys(sorted(split), "BYTE_STREAM_SPLIT"),
        data_page_size=2**30, dictionary_pagesize_limit=2**30,
    )  # fmt: skip


def _check(written: Part, table: pa.Table, entries: Sequence[Entry]) -> None:
    """Raise ValueError where a file does not give back its lines, which :func:`_line` has checked, and the arrays."""
    back = written.table(SCHEMA.names).cast(SCHEMA)
    for name in SCHEMA.names:
        if not _same_column(back[name], table[name]):
            raise ValueError(f"the column {name} does not come back as it is")
    for line, entry in enumerate(entries):
        if _bits(written.arrays(line)) != _bits(entry.arrays):
            raise ValueError(f"the arrays of cell {entry.cell.identity} do not come back as they are")


def _same_column(a: pa.ChunkedArray, b: pa.ChunkedArray) -> bool:
    return repr(a.to_pylist()) == repr(b.to_pylist()) if pa.types.is_floating(a.type) else bool(a.equals(b))  # NaNs


def _bits(arrays: Mapping[str, np.ndarray]) -> list[tuple[Any, ...]]:
    return [(name, one.dtype.str, one.shape, one.tobytes()) for name, one in sorted(arrays.items())]


def _place(entry: Entry) -> tuple[Any, ...]:
    """Like beside like, so that what they share takes little room."""
    what = entry.cell.cell
    order = (what.get(key) for key in ("label", "system", "initial_state"))
    return (*(str(text) for text in order), str(what.get("snr_db")), entry.cell.identity)


def _line(entry: Entry, places: dict[str, list[Any]]) -> dict[str, Any]:
    cell = entry.cell
    line: dict[str, Any] = {"identity": cell.identity, **described(cell), **dict.fromkeys(TEXTS, "")}
    line |= {name: [] for name in LISTS} | {"dof": scores.RAW, "tracebacks": entry.tracebacks}
    for name in OF_ERRORS:
        line.pop(name)
    line |= _kept(entry.arrays, places)
    try:
        columns = {**_summary_columns(cell), **_row_columns(cell), **_score_columns(cell)}
        found = line | columns
        if cell_file(_cell(lambda names: {name: found[name] for name in names})) == entry.file:
            return found
    except (ValueError, TypeError, KeyError, OverflowError):
        pass
    shown = {f"all_{key}": [_shown(one.get(key)) for one in cell.summary.values()] for key in STATISTICS}
    return line | shown | {"whole": entry.file.decode()}


def _shown(value: float | None) -> int:
    """The code of a statistic for the view alone, which has it to six digits."""
    return MISSING if value is None else int(to_codes(np.array(value)))


def _summary_columns(cell: StoredCell) -> dict[str, Any]:
    exact, plain = to_json(cell.cell, 17), {"prior_share": cell.prior_share, "identifiable": cell.identifiable}
    plain |= {"provenance": cell.provenance, "computed_by": cell.version}
    texts = {name: json.dumps(to_json(value), ensure_ascii=False) for name, value in plain.items()}
    return {
        **texts,
        "cell": json.dumps(exact, ensure_ascii=False),
        "arrays": cell.arrays,
        "wall_s": cell.wall_s,
        "metrics": " ".join(cell.summary),
        **{f"all_{key}": listed([one.get(key) for one in cell.summary.values()]) for key in STATISTICS},
    }


def _row_columns(cell: StoredCell) -> dict[str, Any]:
    rows = cell.rows
    return {
        "row_status": [row.status.value for row in rows],
        "row_replicate": [row.replicate for row in rows],
        "row_message": [row.message for row in rows],
        "row_data": [row.data for row in rows],
        "row_evaluations": [row.evaluations for row in rows],
        **{name: listed([getattr(row, name[len("row_") :]) for row in rows]) for name in NUMBERS},
        "row_scored": [bool(row.scores) for row in rows],
    }


def _score_columns(cell: StoredCell) -> dict[str, Any]:
    scored = [bool(row.scores) for row in cell.rows]
    found = {name: list(compress(values, scored)) for name, values in cell.columns.all_scores.items()}
    codes = listed([value for values in found.values() for value in values]).reshape(len(found), sum(scored))
    packed = scores.pack(list(found), codes)
    families = {f"score_{name}": packed.pop(name) for name in scores.FAMILIES}
    return {"scores": " ".join(found), **families, **packed}


def _kept(arrays: Mapping[str, np.ndarray], places: dict[str, list[Any]]) -> dict[str, Any]:
    """The columns of a cell's arrays: an array that an earlier cell has, too, is but named."""
    if any(values.dtype not in (np.dtype("f4"), np.dtype("i8")) for values in arrays.values()):
        return {"npz": arrays_file(arrays), "kept": ""}
    columns: dict[str, list[Any]] = {name: [] for name in ARRAYS if name.startswith("array_")}
    described = []
    for name in sorted(arrays):
        values = arrays[name]
        key = hashlib.sha256(values.tobytes()).hexdigest() + str(values.dtype)
        if key not in places:
            order, exponent, finer_bits, steps, finer = _numbers(values)
            kind = "array_whole" if values.dtype.kind == "i" else "array_bits"
            columns[kind if order == curves.PLAIN else "array_steps"] += steps.tolist()
            columns["array_finer"] += finer.tolist()
            places[key] = [len(places), order, exponent, finer_bits, steps.size, finer.size, values.dtype.kind]
            described.append([name, list(values.shape), places[key]])
        else:
            described.append([name, list(values.shape), places[key][0]])
    return {"kept": json.dumps(described, separators=(",", ":")), "npz": None, **columns}


def _numbers(values: np.ndarray) -> tuple[int, int, int, np.ndarray, np.ndarray]:
    if values.dtype.kind == "i":
        return curves.PLAIN, 0, 0, values.ravel(), np.empty(0, np.int32)
    return curves.taken(values)


# ---- reading


class Part:
    """A file of the archive, of which columns are read when they are first needed.

    ``checked`` says whether its bytes agree with its checksum; only one that was opened as ``older`` may have none.
    """

    def __init__(self, path: Path, older: bool = False) -> None:
        self.path = path
        self._columns: dict[str, Any] = {}
        self._buffer, says, self.checked = checked.read(path, older)
        self.content = says.get(CONTENT_KEY, "")

    @cached_property
    def identities(self) -> list[str]:
        return [str(identity) for identity in self.table(("identity",))["identity"].to_pylist()]

    def table(self, columns: Sequence[str]) -> pa.Table:
        """Some columns as they lie in the file."""
        try:
            return pq.ParquetFile(pa.BufferReader(self._buffer)).read(list(columns))
        except (OSError, pa.ArrowException, KeyError, ValueError):
            raise InputError("archive", self.path, checked.REMEDY) from None

    def line(self, number: int, columns: Sequence[str]) -> dict[str, Any]:
        """Some columns of one line: texts and numbers as they are, lists as arrays."""
        if any(name not in self._columns for name in columns):
            found = self.table(columns)
            self._columns |= {name: _column(found[name]) for name in columns}
        return {name: _item(self._columns[name], number) for name in columns}

    def cell(self, number: int) -> StoredCell:
        """The cell of a line; its rows and scores are unpacked when they are asked for."""
        return _cell(partial(self.line, number))

    def tracebacks(self, number: int) -> str:
        return str(self.line(number, ("tracebacks",))["tracebacks"])

    def arrays(self, number: int) -> dict[str, np.ndarray]:
        """The arrays kept of a cell's replicate."""
        line = self.line(number, ARRAYS)
        if line["npz"]:
            with np.load(io.BytesIO(line["npz"]), allow_pickle=False) as found:
                return {name: found[name] for name in found.files}
        arrays = {}
        for name, shape, place in json.loads(line["kept"] or "[]"):
            arrays[name] = self._array(place if isinstance(place, int) else place[0]).reshape(shape)
        return arrays

    @cached_property
    def _places(self) -> list[tuple[list[Any], int, int]]:
        """Of every array of the file in order: what is said of it, and where its numbers and the finer ones begin."""
        begins = dict.fromkeys(("array_bits", "array_steps", "array_whole", "array_finer"), 0)
        found = []
        for text in self.table(("kept",))["kept"].to_pylist():
            for _, _, place in json.loads(text or "[]"):
                if not isinstance(place, int):
                    column = _holder(place)
                    found.append((place, begins[column], begins["array_finer"]))
                    begins[column] += place[4]
                    begins["array_finer"] += place[5]
        return found

    def _array(self, number: int) -> np.ndarray:
        (_, order, exponent, finer_bits, size, more, kind), begin, finer_begin = self._places[number]
        numbers = self._columns[_holder(self._places[number][0])][0][begin : begin + size]
        if kind == "i":
            return np.array(numbers, np.int64)
        finer = self._columns["array_finer"][0][finer_begin : finer_begin + more]
        return curves.restored(order, exponent, finer_bits, numbers, finer)


def _holder(place: Sequence[Any]) -> str:
    if place[1] != curves.PLAIN:
        return "array_steps"
    return "array_whole" if place[6] == "i" else "array_bits"


def _column(column: pa.ChunkedArray) -> Any:
    """Texts and numbers as a list; lists as all their items, and where each begins."""
    whole = column.combine_chunks() if column.num_chunks != 1 else column.chunk(0)
    if not pa.types.is_list(column.type):
        return whole.to_pylist()
    items = whole.flatten()
    plain = pa.types.is_string(items.type)
    numbers = np.array(items.to_pylist(), object) if plain else items.to_numpy(zero_copy_only=False)
    return numbers, np.asarray(whole.offsets) - whole.offsets[0].as_py()


def _item(column: Any, number: int) -> Any:
    if isinstance(column, list):
        return column[number]
    items, begins = column
    return items[begins[number] : begins[number + 1]]


def _cell(line: Line) -> StoredCell:
    plain = line(("identity", "wall_s", *SUMMARY))
    if plain["whole"]:
        return cell_from_json(json.loads(plain["whole"]))
    metrics = plain["metrics"].split(" ") if plain["metrics"] else []
    codes = np.array([plain[f"all_{key}"] for key in STATISTICS]).reshape(len(STATISTICS), len(metrics))
    columns = zip(metrics, from_codes(codes).T.tolist(), (codes != MISSING).T.tolist(), strict=True)
    return StoredCell(
        identity=plain["identity"],
        cell=json.loads(plain["cell"]),
        rows=PackedRows(line),
        summary={
            metric: {key: value for key, value, known in zip(STATISTICS, values, there, strict=True) if known}
            for metric, values, there in columns
        },
        prior_share=_numbers_of(json.loads(plain["prior_share"])),
        identifiable=json.loads(plain["identifiable"]),
        wall_s=plain["wall_s"],
        provenance=json.loads(plain["provenance"]),
        version=json.loads(plain["computed_by"]),
        arrays=plain["arrays"],
    )


def _numbers_of(values: Mapping[str, Any]) -> dict[str, float]:
    return {name: float(value) for name, value in values.items()}
