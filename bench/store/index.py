"""The collected view of a store: one line a cell in Parquet, for reading many cells at once.

Derived from the cells' files, and brought up to date whenever it is read: only files that are new or changed are
opened. It may be deleted at any time. ``pandas.read_parquet("outputs/rows/view")`` reads it, too. The name of a part is
the digest of its bytes: one that is damaged, or was made from cells of another format, is removed and made anew.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from bench.errors import InputError
from bench.store.line import LISTS, PLAIN, SCHEMA, STATISTICS, described
from bench.store.store import Store, Unreadable, named_by
from bench.store.stored import FORMAT

if TYPE_CHECKING:
    import pandas as pd

MOST_PARTS = 8
BATCH = 5_000
"""Cells read before a part is written: bounds the memory of a first collection."""


def cells(store: Store, columns: Iterable[str] = tuple(PLAIN)) -> pd.DataFrame:
    """One line a stored cell, indexed by identity; ``columns`` of :data:`SCHEMA`.

    ``problem`` is empty, or says in one line why a file is not a cell; ``statuses`` is a JSON object of counts. The
    lists ``median`` etc. run in parallel with the names in ``metrics``, which blanks separate.
    """
    wanted = list(dict.fromkeys(["identity", "mtime_ns", "size", *columns]))
    there, found = _files(store), _load(store, wanted)
    fresh = _current(found, there)
    changed = [name for name in there if name not in fresh]
    unsaved = []
    for i in range(0, len(changed), BATCH):
        lines, passing = [], []
        for name in changed[i : i + BATCH]:
            try:
                lines.append(_line(store, name, there[name]))
            except Unreadable as error:
                passing.append(_stamped(name, there[name]) | {"problem": str(error)})
        part = pa.Table.from_pylist(lines, SCHEMA)
        if not _write(store, part):
            unsaved.append(part.select(wanted))
        unsaved.append(pa.Table.from_pylist(passing, SCHEMA).select(wanted))
    if found.num_rows > 2 * len(fresh) + BATCH or len(_parts(store)) > MOST_PARTS:
        _compact(store, there)
    if changed:
        found = pa.concat_tables([_load(store, wanted), *unsaved])
        fresh = _current(found, there)
    found = found.take(pa.array([fresh[name] for name in fresh], pa.int64()))
    lines = pa.concat_tables([found, *_archived(store, there, wanted)]).to_pandas().set_index("identity")
    return lines.sort_index()[[name for name in columns if name != "identity"]]


def _archived(store: Store, there: Mapping[str, Any], wanted: Sequence[str]) -> list[pa.Table]:
    """Some columns of the cells that the archive has and the store's folder has not."""
    if store.archive is None:
        return []
    statistics = [name for name in wanted if name in LISTS]
    return [_without(table, there).select(wanted) for table in store.archive.tables(statistics)]


def _without(table: pa.Table, there: Mapping[str, Any]) -> pa.Table:
    """The lines of a file of the archive that nothing in the store's folder stands in the place of, as of the view."""
    keep = [i for i, name in enumerate(table["identity"].to_pylist()) if name not in there]
    table = table.take(pa.array(keep, pa.int64()))
    plain = {"mtime_ns": 0, "size": 0, "problem": ""}
    for name, value in plain.items():
        table = table.append_column(name, pa.array([value] * table.num_rows, SCHEMA.field(name).type))
    names = [name for name in SCHEMA.names if name in table.column_names]
    return table.select(names).cast(pa.schema([SCHEMA.field(name) for name in names]))


def summaries(store: Store, metrics: Sequence[str]) -> pd.DataFrame:
    """One line a cell and metric: the cell's plain columns and the statistics of the metrics asked for."""
    import pandas as pd

    cells(store, ())  # brings the view up to date
    there, pieces = _files(store), []
    seen: set[str] = set()
    for batch in _batches(store):
        lines = {name: i for name, i in _current(batch, there).items() if name not in seen}
        seen.update(lines)
        own = batch.take(pa.array(list(lines.values()), pa.int64()))
        pieces.append(_flat(own, metrics))
    pieces += [_flat(table, metrics) for table in _archived(store, there, SCHEMA.names)]
    if not pieces:
        return pd.DataFrame(columns=[*(name for name in PLAIN if name != "metrics"), "metric", *STATISTICS])
    return pd.concat(pieces).sort_values("identity", kind="stable", ignore_index=True)


def _batches(store: Store) -> Iterator[pa.Table]:
    """The view a few thousand cells at a time; where it could not be written, the cells themselves."""
    parts = _parts(store)
    for part in parts:
        for batch in pq.ParquetFile(part).iter_batches(batch_size=BATCH):
            yield pa.Table.from_batches([batch]).cast(SCHEMA)
    if not parts:
        there = _files(store)
        yield pa.Table.from_pylist([_line(store, name, there[name]) for name in there], SCHEMA)


def _flat(batch: pa.Table, metrics: Sequence[str]) -> pd.DataFrame:
    """The lines of some cells, one a metric."""
    batch = batch.filter(pc.equal(batch["problem"], ""))
    texts = batch["metrics"].to_pylist()
    names = {text: np.array(text.split(), object) for text in set(texts)}
    metric = np.concatenate([names[text] for text in texts] or [np.empty(0, object)])
    chosen = np.isin(metric.astype(str), list(metrics))
    row = np.repeat(np.arange(len(texts)), [len(names[text]) for text in texts])[chosen]
    flat = {name: pc.list_flatten(batch[name]).to_numpy()[chosen] for name in STATISTICS}
    plain = batch.drop_columns([*STATISTICS, "metrics"]).take(pa.array(row)).to_pandas()
    return plain.assign(metric=metric[chosen], **flat)


def _files(store: Store) -> dict[str, tuple[int, int]]:
    """Time of change and size of every cell's file, by identity."""
    found: dict[str, tuple[int, int]] = {}
    if not store.folder.is_dir():
        return found
    with os.scandir(store.folder) as entries:
        for entry in entries:
            if name := named_by(entry):
                with contextlib.suppress(OSError):  # gone in between
                    stat = entry.stat()
                    found[name] = (stat.st_mtime_ns, stat.st_size)
    return found


def _parts(store: Store) -> list[str]:
    """Its parts that are whole; what is none of them goes."""
    whole = []
    with contextlib.suppress(OSError):
        for path in sorted(store.view.glob("*.parquet")):
            with contextlib.suppress(FileNotFoundError):  # another reader has just merged it away
                if path.name == _name(path):
                    whole.append(str(path))
                else:
                    path.unlink()
    return whole


def _name(path: Path) -> str:
    """What a part with these bytes is called, for cells of the format that is read."""
    with path.open("rb") as file:
        return f"{FORMAT}-{hashlib.file_digest(file, 'sha256').hexdigest()[:32]}.parquet"


def _load(store: Store, columns: Sequence[str]) -> pa.Table:
    tables = [pa.schema([SCHEMA.field(name) for name in columns]).empty_table()]
    for part in _parts(store):
        # a part that another reader has just merged away, or that a stranger has named so, is read anew from the cells
        with contextlib.suppress(OSError, pa.ArrowException, KeyError):
            tables.append(pq.read_table(part, columns=list(columns)).cast(tables[0].schema))
    return pa.concat_tables(tables)


def _current(found: pa.Table, there: Mapping[str, tuple[int, int]]) -> dict[str, int]:
    """The line of every cell whose file is as it was when that line was written."""
    names, times, sizes = (found[name].to_pylist() for name in ("identity", "mtime_ns", "size"))
    stamps = zip(names, zip(times, sizes, strict=True), strict=True)
    return {name: i for i, (name, stamp) in enumerate(stamps) if there.get(name) == stamp}


def _write(store: Store, part: pa.Table) -> bool:
    """Write a part whole; False where the store cannot be written, which a reader need not be able to."""
    if not part.num_rows:
        return True
    try:
        store.view.mkdir(exist_ok=True)
        _new_part(store, lambda temporary: pq.write_table(part, temporary, compression="zstd"))
    except OSError:
        return False
    return True


def _new_part(store: Store, write: Callable[[Path], None]) -> Path:
    """The part that a function writes to the file it is given; nothing is left of it where that raises."""
    temporary = store.view / f"{uuid.uuid4().hex}.tmp"
    try:
        write(temporary)
        place = store.view / _name(temporary)
        os.replace(temporary, place)
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()
    return place


def _compact(store: Store, there: Mapping[str, tuple[int, int]]) -> None:
    """All parts in one, part by part; a reader that meets one going reads those cells anew."""
    parts = _parts(store)

    def write(temporary: Path) -> None:
        seen: set[str] = set()
        with pq.ParquetWriter(temporary, SCHEMA, compression="zstd") as writer:
            for part in parts:
                table = pq.read_table(part, schema=SCHEMA)
                lines = _current(table, there)
                keep = [i for name, i in lines.items() if name not in seen]
                seen.update(lines)
                writer.write_table(table.take(pa.array(keep, pa.int64())))

    with contextlib.suppress(OSError, pa.ArrowException):
        whole = _new_part(store, write)
        for part in set(parts) - {str(whole)}:
            os.unlink(part)


def _stamped(identity: str, stamp: tuple[int, int]) -> dict[str, Any]:
    return {"identity": identity, "mtime_ns": stamp[0], "size": stamp[1], "problem": ""}


def _line(store: Store, identity: str, stamp: tuple[int, int]) -> dict[str, Any]:
    """What the view says of a file; raises Unreadable where it could not be read just now."""
    line = _stamped(identity, stamp)
    try:
        cell = store.load(identity)
    except Unreadable:
        raise
    except InputError as error:
        return line | {"problem": str(error)}
    return line if cell is None else line | described(cell)
