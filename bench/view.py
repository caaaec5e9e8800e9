"""The collected view of a store: one line a cell in Parquet, for reading many cells at once.

Derived from the cells' files, and brought up to date whenever it is read: only files that are new or changed are
opened. It may be deleted at any time. ``pandas.read_parquet("results/rows/view")`` reads it, too.
"""

from __future__ import annotations

import contextlib
import json
import os
import uuid
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from bench.errors import InputError
from bench.store import Store, StoredCell

PLAIN = {
    "identity": pa.string(), "mtime_ns": pa.int64(), "size": pa.int64(), "problem": pa.string(),
    "method": pa.string(), "label": pa.string(), "system": pa.string(), "snr_db": pa.float64(),
    "initial_state": pa.string(), "disturbance": pa.string(), "replicates": pa.int64(), "seed": pa.int64(),
    "n_ok": pa.int64(), "statuses": pa.string(), "version": pa.string(), "wall_s": pa.float64(),
    "cpu_s": pa.float64(), "peak_memory_mb": pa.float64(), "started": pa.string(), "commit": pa.string(),
    "data": pa.string(),
}  # fmt: skip
STATISTICS = ("mean", "median", "ci_low", "ci_high", "bound", "excess")
LISTS = {"metric": pa.list_(pa.string()), **{name: pa.list_(pa.float64()) for name in STATISTICS}}
SCHEMA = pa.schema({**PLAIN, **LISTS})
MOST_PARTS = 8
BATCH = 5_000
"""Cells read before a part is written: bounds the memory of a first collection."""


def cells(store: Store, columns: Iterable[str] = tuple(PLAIN)) -> pd.DataFrame:
    """One line a stored cell, indexed by identity; ``columns`` of :data:`SCHEMA`.

    ``problem`` is empty, or says in one line why a file is not a cell; ``statuses`` is a JSON object of counts. The
    lists ``metric``, ``median`` etc. run in parallel.
    """
    if not store.folder.is_dir():
        return pd.DataFrame(columns=list(columns)).rename_axis("identity")
    there = _files(store)
    known = _load(store, ("identity", "mtime_ns", "size"))
    fresh = _unchanged(known, there)
    changed = [name for name in there if name not in fresh]
    unsaved = []
    for i in range(0, len(changed), BATCH):
        part = pa.Table.from_pylist([_line(store, n, there[n]) for n in changed[i : i + BATCH]], SCHEMA)
        if not _write(store, part):
            unsaved.append(part)
    dead = len(known) > len(fresh)
    if (dead and len(known) > 2 * len(fresh)) or len(_parts(store)) > MOST_PARTS:
        _compact(store, there)
    wanted = list(dict.fromkeys(["identity", "mtime_ns", "size", *columns]))
    frames = [_load(store, wanted), *(part.select(wanted).to_pandas() for part in unsaved)]
    return _current(pd.concat(frames) if unsaved else frames[0], there)[
        [name for name in columns if name != "identity"]
    ]


def summaries(store: Store, metrics: Sequence[str]) -> pd.DataFrame:
    """One line a cell and metric: the cell's plain columns and the statistics of the metrics asked for."""
    found = cells(store, (*PLAIN, *LISTS))
    wanted = found[found["problem"] == ""].reset_index()
    lengths = wanted["metric"].map(len).to_numpy(dtype=int)
    flat = {name: np.concatenate([np.asarray(v) for v in wanted[name]] or [np.empty(0)]) for name in LISTS}
    chosen = np.isin(flat["metric"].astype(str), list(metrics))
    row = np.repeat(np.arange(len(wanted)), lengths)[chosen]
    plain = wanted.drop(columns=list(LISTS)).iloc[row].reset_index(drop=True)
    return plain.assign(**{name: values[chosen] for name, values in flat.items()})


def _files(store: Store) -> dict[str, tuple[int, int]]:
    """Time of change and size of every cell's file, by identity."""
    found = {}
    with os.scandir(store.folder) as entries:
        for entry in entries:
            if entry.name.endswith(".json"):
                with contextlib.suppress(OSError):  # gone in between
                    stat = entry.stat()
                    found[entry.name[: -len(".json")]] = (stat.st_mtime_ns, stat.st_size)
    return found


def _parts(store: Store) -> list[str]:
    with contextlib.suppress(OSError):
        return sorted(str(path) for path in store.view.glob("*.parquet"))
    return []


def _load(store: Store, columns: Sequence[str]) -> pd.DataFrame:
    tables = []
    for part in _parts(store):
        # a part that another reader has just merged away, or that a stranger put there, is read anew from the cells
        with contextlib.suppress(OSError, pa.ArrowException, KeyError):
            tables.append(pq.read_table(part, columns=list(columns)))
    if not tables:
        return pd.DataFrame({name: pd.Series(dtype="object") for name in columns})
    return pa.concat_tables(tables).to_pandas()


def _unchanged(known: pd.DataFrame, there: Mapping[str, tuple[int, int]]) -> set[str]:
    lines = zip(known["identity"], known["mtime_ns"], known["size"], strict=True)
    return {name for name, changed, size in lines if there.get(name) == (changed, size)}


def _current(lines: pd.DataFrame, there: Mapping[str, tuple[int, int]]) -> pd.DataFrame:
    stamps = zip(lines["identity"], lines["mtime_ns"], lines["size"], strict=True)
    keep = [there.get(name) == (changed, size) for name, changed, size in stamps]
    return lines[np.array(keep, bool)].drop_duplicates("identity").set_index("identity").sort_index()


def _write(store: Store, part: pa.Table) -> bool:
    """Write a part whole; False where the store cannot be written, which a reader need not be able to."""
    if not part.num_rows:
        return True
    path = store.view / f"{uuid.uuid4().hex}.parquet"
    temporary = path.with_suffix(".tmp")
    try:
        store.view.mkdir(exist_ok=True)
        pq.write_table(part, temporary, compression="zstd")
        os.replace(temporary, path)
    except OSError:
        with contextlib.suppress(OSError):
            temporary.unlink()
        return False
    return True


def _compact(store: Store, there: Mapping[str, tuple[int, int]]) -> None:
    """All parts in one; a reader that meets a part going reads those cells anew."""
    parts = _parts(store)
    with contextlib.suppress(OSError, pa.ArrowException):
        whole = pa.concat_tables([pq.read_table(part, schema=SCHEMA) for part in parts])
        stamps = zip(*(whole[name].to_pylist() for name in ("identity", "mtime_ns", "size")), strict=True)
        latest = {name: i for i, (name, changed, size) in enumerate(stamps) if there.get(name) == (changed, size)}
        if _write(store, whole.take(sorted(latest.values()))):
            for part in parts:
                os.unlink(part)


def _line(store: Store, identity: str, stamp: tuple[int, int]) -> dict[str, Any]:
    line: dict[str, Any] = {"identity": identity, "mtime_ns": stamp[0], "size": stamp[1], "problem": ""}
    try:
        cell = store.load(identity)
    except InputError as error:
        return line | {"problem": str(error)}
    return line if cell is None else line | _described(cell)


def _described(cell: StoredCell) -> dict[str, Any]:
    what, come = cell.cell, cell.provenance
    disturbance = what.get("data", {}).get("disturbance") or {}
    cpu = [row.cpu_s for row in cell.rows if np.isfinite(row.cpu_s)]
    memory = [row.peak_memory_mb for row in cell.rows if np.isfinite(row.peak_memory_mb)]
    return {
        **{name: what.get(name) for name in ("method", "label", "system", "snr_db", "initial_state", "seed")},
        "disturbance": str(disturbance.get("kind", "none")),
        "replicates": len(cell.rows),
        "n_ok": cell.n_ok,
        "statuses": json.dumps(Counter(row.status.value for row in cell.rows)),
        "version": cell.version.get("digest", ""),
        "wall_s": cell.wall_s,
        "cpu_s": float(np.sum(cpu)) if cpu else None,
        "peak_memory_mb": max(memory, default=None),
        "started": come.get("started"),
        "commit": come.get("commit"),
        "data": come.get("data"),
        "metric": list(cell.summary),
        **{name: [summary.get(name) for summary in cell.summary.values()] for name in STATISTICS},
    }
