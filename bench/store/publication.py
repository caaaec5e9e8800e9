"""Writing the published archive (:mod:`bench.store.archive`): all of its files, then the list of their checksums."""

from __future__ import annotations

import hashlib
import io
import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.files import write_together
from bench.scoring.row import NUMBERS as NUMBERS_OF_FIT
from bench.scoring.row import STATISTICS
from bench.store.archive import ARRAYS, BOUNDS, CELLS, SUMMARIES, SUMS, read_sums, rows_file
from bench.store.cell_file import EXACT_DIGITS, to_json
from bench.store.digits import BITS, binary
from bench.store.stored import StoredCell
from bench.store.version import NUMBERS

if TYPE_CHECKING:
    import pyarrow as pa

ARRAY_BITS = 17
"""Binary digits behind the first of the numbers of arrays: five decimal ones."""
TRACE, SINGLE_BITS = "trace_", 23
"""Traces of a search keep all digits of single precision: pictures show differences of objectives."""
LARGEST_SINGLE = 3e38
"""A column with a larger finite number is kept in double precision."""


def write_archive(
    folder: Path, experiments: Mapping[str, Sequence[StoredCell]], bounds: Mapping[str, str]
) -> list[Path]:
    """Write an archive with these cells by experiment, and these bounds; returns the files that have changed.

    Nothing is touched before all files are written beside the old ones. Raises OSError without room.
    """
    ordered = {name: sorted(cells, key=_place) for name, cells in sorted(experiments.items())}
    cells = [cell for group in ordered.values() for cell in group]
    files = {rows_file(name): _rows_bytes(group) for name, group in ordered.items()}
    files[CELLS] = _lines_bytes([_line(name, cell) for name, group in ordered.items() for cell in group])
    files[SUMMARIES] = _summaries_bytes(cells)
    files[ARRAYS] = _arrays_bytes(cells)
    files[BOUNDS] = _lines_bytes([{"identity": name, "text": text} for name, text in sorted(bounds.items())])
    return _replace(folder, files)


def _replace(folder: Path, files: Mapping[str, bytes]) -> list[Path]:
    before = read_sums(folder)
    sums = {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}
    if sums == before:
        return []
    written = {name: content for name, content in files.items() if sums[name] != before.get(name)}
    written[SUMS] = "".join(f"{digest}  {name}\n" for name, digest in sorted(sums.items())).encode()
    (folder / "rows").mkdir(parents=True, exist_ok=True)
    write_together({folder / name: content for name, content in written.items()})
    gone = [folder / name for name in before.keys() - sums.keys()]
    for path in gone:
        path.unlink(missing_ok=True)
    return [folder / name for name in sorted(written)] + gone


def _place(cell: StoredCell) -> tuple[Any, ...]:
    """Order like beside like, so that what they share takes little room."""
    return (*(str(cell.cell.get(key)) for key in ("label", "system", "initial_state", "snr_db")), cell.identity)


def _line(experiment: str, cell: StoredCell) -> dict[str, Any]:
    """Return the line of a cell in ``cells.parquet``."""
    what, data = cell.cell, cell.cell.get("data", {})
    texts = {
        "description": to_json(what, EXACT_DIGITS),
        "statuses": Counter(status.value for status in cell.columns.statuses),
        **{name: to_json(getattr(cell, name)) for name in ("prior_share", "identifiable", "provenance")},
    }
    return {
        "identity": cell.identity,
        "experiment": experiment,
        **{name: what.get(name) for name in ("method", "label", "system")},
        "equations": data.get("system"),
        "snr_db": _float(what.get("snr_db")),
        "initial_state": what.get("initial_state"),
        "disturbance": (data.get("disturbance") or {}).get("kind", "none"),
        "seed": what.get("seed"),
        "replicates": len(cell.columns),
        "metrics": len(cell.summary),
        "arrays": len(cell.arrays),
        "n_ok": cell.n_ok,
        "wall_s": float(cell.wall_s),
        "cpu_s": float(np.nansum(cell.columns.numbers("cpu_s"))),
        **{f"{name}_version": cell.version.get(name) for name in NUMBERS},
        **{name: cell.provenance.get(name) for name in ("started", "commit")},
        **{name: json.dumps(value, ensure_ascii=False) for name, value in texts.items()},
        "tracebacks": cell.tracebacks,
    }


def _float(value: Any) -> float | None:
    return None if value is None else float(value)


def _rows_bytes(cells: Sequence[StoredCell]) -> bytes:
    names = sorted({name for cell in cells for name in cell.columns.score_names})
    columns = {
        "identity": [cell.identity for cell in cells for _ in range(len(cell.columns))],
        "replicate": _whole(cells, "replicate"),
        "status": [status.value for cell in cells for status in cell.columns.statuses],
        **{name: [text for cell in cells for text in cell.columns.texts(name)] for name in ("message", "data")},
        "evaluations": _whole(cells, "evaluations"),
    }
    numbers = {name: np.concatenate([cell.columns.numbers(name) for cell in cells]) for name in NUMBERS_OF_FIT}
    numbers |= {name: np.concatenate([cell.columns.scores(name) for cell in cells]) for name in names}
    return _table_bytes(columns, {name: _single(values) for name, values in numbers.items()})


def _whole(cells: Sequence[StoredCell], name: str) -> np.ndarray:
    return np.concatenate([cell.columns.numbers(name) for cell in cells]).astype(int)


def _summaries_bytes(cells: Sequence[StoredCell]) -> bytes:
    lines = [(cell.identity, metric, line) for cell in cells for metric, line in cell.summary.items()]
    columns = {"identity": [line[0] for line in lines], "metric": [line[1] for line in lines]}
    numbers = {name: np.array([line[2].get(name, np.nan) for line in lines], float) for name in STATISTICS}
    return _table_bytes(columns, {name: binary(values) for name, values in numbers.items()})


def _arrays_bytes(cells: Iterable[StoredCell]) -> bytes:
    """An array that an earlier cell has under the same name is not written again, but refers to it."""
    first: dict[tuple[str, str], str] = {}
    lines = []
    for cell in cells:
        for name, values in sorted(cell.arrays.items()):
            key = name, hashlib.sha256(values.tobytes()).hexdigest()
            same_as = first.setdefault(key, cell.identity)
            own = same_as == cell.identity
            bits = SINGLE_BITS if name.startswith(TRACE) else ARRAY_BITS
            lines.append({
                "identity": cell.identity, "name": name, "shape": list(values.shape),
                "whole": values.dtype.kind == "i", "same_as": None if own else same_as,
                "values": _single(values.ravel().astype(float), bits) if own else np.empty(0, np.float32),
            })  # fmt: skip
    return _lines_bytes(lines, lists="values")


def _single(values: np.ndarray, bits: int = BITS) -> np.ndarray:
    """Round numbers, and return them in single precision where all fit."""
    values = binary(values, bits)
    finite = np.abs(values[np.isfinite(values)])
    return values if finite.size and finite.max() > LARGEST_SINGLE else values.astype(np.float32)


def _lines_bytes(lines: Sequence[Mapping[str, Any]], lists: str = "") -> bytes:
    import pyarrow as pa

    columns = {name: [line[name] for line in lines] for name in (lines[0] if lines else ())}
    types = {lists: pa.list_(pa.float32()), "shape": pa.list_(pa.int32()), "same_as": pa.string()}
    table = pa.table({name: pa.array(values, types.get(name)) for name, values in columns.items()})
    return _written(table, [f"{lists}.list.element"] if lists else [])


def _table_bytes(columns: Mapping[str, Any], numbers: Mapping[str, np.ndarray]) -> bytes:
    import pyarrow as pa

    arrays = {name: pa.array(values, from_pandas=True) for name, values in numbers.items()}
    split = [name for name, values in numbers.items() if not _repetitive(values)]
    return _written(pa.table({**columns, **arrays}), split)


def _repetitive(values: np.ndarray) -> bool:
    """Return whether a column has few different values, which a dictionary holds in less room."""
    return len(np.unique(values)) < 256


def _written(table: pa.Table, split: Sequence[str]) -> bytes:
    """Return the bytes of a table; columns of many different floats are stored by byte, which compresses best."""
    import pyarrow.parquet as pq

    leaves = [f"{name}.list.element" if name in ("values", "shape") else name for name in table.column_names]
    buffer = io.BytesIO()
    pq.write_table(
        table, buffer, compression="zstd", compression_level=19, row_group_size=max(1, table.num_rows),
        use_dictionary=[name for name in leaves if name not in split], store_schema=False, write_statistics=False,
        column_encoding=dict.fromkeys(split, "BYTE_STREAM_SPLIT"), data_page_size=2**24,
        dictionary_pagesize_limit=2**24,
    )  # fmt: skip
    return buffer.getvalue()
