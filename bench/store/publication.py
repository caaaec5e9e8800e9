"""Writing of the published archive (:mod:`bench.store.archive`)."""

from __future__ import annotations

import hashlib
import io
import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench.files import write_together
from bench.scoring.row import NUMBERS as NUMBERS_OF_FIT
from bench.scoring.row import STATISTICS
from bench.store.archive import ARRAYS, BOUNDS, CELLS, SUMMARIES, SUMS, read_sums, rows_file
from bench.store.cell_file import EXACT_DIGITS, to_json
from bench.store.digits import BITS, binary
from bench.store.stored_cell import StoredCell
from bench.store.version import NUMBERS

ARRAY_BITS = 14
"""Binary digits after the leading one of the numbers in arrays, equivalent to four decimal digits."""
TRACE, SINGLE_BITS = "trace_", 23
"""Traces of a search are stored in full single precision, since figures show differences of objectives."""
FEW = 256
"""Columns with fewer distinct floats are dictionary-encoded, which is smaller."""
LARGEST_SINGLE = 3e38
"""A column with a larger finite number is stored in double precision."""


def write_archive(
    folder: Path, experiments: Mapping[str, Sequence[StoredCell]], bounds: Mapping[str, str]
) -> list[Path]:
    """Write an archive; existing files are replaced only after all new files have been written.

    Args:
        folder: The archive.
        experiments: Cells by experiment.
        bounds: Texts of the bounds by identity.

    Returns:
        The files that have changed.

    Raises:
        OSError: The files cannot be written.
    """
    ordered = {name: sorted(cells, key=_place) for name, cells in sorted(experiments.items())}
    cells = [cell for group in ordered.values() for cell in group]
    files = {rows_file(name): _rows_bytes(group) for name, group in ordered.items()}
    lines = [_line(name, cell) for name, group in ordered.items() for cell in group]
    names = dict.fromkeys(name for line in lines for name in line)
    files[CELLS] = _parquet({name: [line.get(name) for line in lines] for name in names})
    files[SUMMARIES] = _summaries_bytes(cells)
    files[ARRAYS] = _arrays_bytes(cells)
    files[BOUNDS] = _parquet({"identity": sorted(bounds), "text": [bounds[name] for name in sorted(bounds)]})
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
    removed = [folder / name for name in before.keys() - sums.keys()]
    for path in removed:
        path.unlink(missing_ok=True)
    return [folder / name for name in sorted(written)] + removed


def _place(cell: StoredCell) -> tuple[Any, ...]:
    """Return the sort key of a cell, which puts similar cells next to each other for better compression."""
    return (*(str(cell.cell.get(key)) for key in ("label", "system", "initial_state", "snr_db")), cell.identity)


def _line(experiment: str, cell: StoredCell) -> dict[str, Any]:
    """Return the row of a cell in ``cells.parquet``."""
    what, data = cell.cell, cell.cell.get("data", {})
    texts = {
        "description": to_json(what, EXACT_DIGITS),
        "statuses": Counter(status.value for status in cell.columns.statuses),
        **{name: to_json(getattr(cell, name)) for name in ("prior_share", "identifiable", "provenance")},
    }
    supplied = {name: number for name, number in cell.version.items() if name not in NUMBERS}
    if supplied:
        texts["supplied_versions"] = supplied
    return {
        "identity": cell.identity,
        "experiment": experiment,
        **{name: what.get(name) for name in ("method", "label", "system")},
        "equations": data.get("system"),
        "snr_db": None if what.get("snr_db") is None else float(what["snr_db"]),
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


def _rows_bytes(cells: Sequence[StoredCell]) -> bytes:
    def joined(name: str) -> np.ndarray:
        return np.concatenate([cell.columns.numbers(name) for cell in cells])

    scores = sorted({name for cell in cells for name in cell.columns.score_names})
    return _parquet({
        "identity": [cell.identity for cell in cells for _ in cell.columns.statuses],
        "replicate": joined("replicate").astype(int),
        "status": [status.value for cell in cells for status in cell.columns.statuses],
        **{name: [text for cell in cells for text in cell.columns.plain(name)] for name in ("message", "data")},
        "evaluations": joined("evaluations").astype(int),
        **{name: _single(joined(name)) for name in NUMBERS_OF_FIT},
        **{name: _single(np.concatenate([cell.columns.scores(name) for cell in cells])) for name in scores},
    })  # fmt: skip


def _summaries_bytes(cells: Sequence[StoredCell]) -> bytes:
    lines = [(cell.identity, metric, line) for cell in cells for metric, line in cell.summary.items()]
    numbers = {name: np.array([line.get(name, np.nan) for *_, line in lines], float) for name in STATISTICS}
    names = {"identity": [identity for identity, *_ in lines], "metric": [metric for _, metric, _ in lines]}
    return _parquet({**names, **{name: binary(values) for name, values in numbers.items()}})


def _arrays_bytes(cells: Iterable[StoredCell]) -> bytes:
    """Return the file of arrays; an array equal to one of an earlier cell is stored as a reference to that cell."""
    import pyarrow as pa

    first: dict[tuple[str, str], str] = {}
    lines = []
    for cell in cells:
        for name, values in sorted(cell.arrays.items()):
            key = name, hashlib.sha256(values.tobytes()).hexdigest()
            same_as = first.setdefault(key, cell.identity)
            new = same_as == cell.identity
            bits = SINGLE_BITS if name.startswith(TRACE) else ARRAY_BITS
            numbers = _single(values.ravel().astype(float), bits) if new else np.empty(0, np.float32)
            whole = values.dtype.kind == "i"
            lines.append((cell.identity, name, list(values.shape), whole, None if new else same_as, numbers))
    names = ("identity", "name", "shape", "whole", "same_as", "values")
    types = {"shape": pa.list_(pa.int32()), "same_as": pa.string(), "values": pa.list_(pa.float32())}
    return _parquet({
        name: pa.array([line[i] for line in lines], types.get(name)) for i, name in enumerate(names)
    })  # fmt: skip


def _single(values: np.ndarray, bits: int = BITS) -> np.ndarray:
    """Round numbers, and convert them to single precision if all are in its range."""
    values = binary(values, bits)
    finite = np.abs(values[np.isfinite(values)])
    return values if finite.size and finite.max() > LARGEST_SINGLE else values.astype(np.float32)


def _parquet(columns: Mapping[str, Any]) -> bytes:
    """Return the content of a Parquet file; columns of many distinct floats are split by byte, which compresses
    best."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    floats = [name for name, values in columns.items() if isinstance(values, np.ndarray) and values.dtype.kind == "f"]
    table = pa.table({
        name: pa.array(values, from_pandas=True) if name in floats else values for name, values in columns.items()
    })  # fmt: skip
    split = ["values.list.element", *(name for name in floats if len(np.unique(columns[name])) >= FEW)]
    leaves = [f"{name}.list.element" if name in ("values", "shape") else name for name in columns]
    split = [name for name in split if name in leaves]
    buffer = io.BytesIO()
    pq.write_table(
        table, buffer, compression="zstd", compression_level=19, row_group_size=max(1, table.num_rows),
        use_dictionary=[name for name in leaves if name not in split], store_schema=False, write_statistics=False,
        column_encoding=dict.fromkeys(split, "BYTE_STREAM_SPLIT"), data_page_size=2**24,
        dictionary_pagesize_limit=2**24,
    )  # fmt: skip
    return buffer.getvalue()
