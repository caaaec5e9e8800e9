"""The file of the archive that holds bounds: their texts by identity."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from bench.errors import InputError
from bench.store.archive import checked

NAME = "bounds.parquet"


def write_bounds(folder: Path, texts: Mapping[str, str]) -> Path:
    """Write the texts of all bounds; returns the file."""
    path, names = folder / NAME, sorted(texts)
    table = pa.table({"identity": names, "text": [texts[name] for name in names]})
    checked.write(path, table, {}, compression="zstd", compression_level=19)
    return path


def read_bounds(folder: Path, older: bool = False) -> dict[str, str]:
    """The texts of all bounds by identity, none where there is no such file; raises InputError for a damaged one."""
    path = folder / NAME
    if not path.exists():
        return {}
    try:
        table = pq.read_table(pa.BufferReader(checked.read(path, older).buffer))
        return dict(zip(table["identity"].to_pylist(), table["text"].to_pylist(), strict=True))
    except (pa.ArrowException, KeyError):
        raise InputError("archive", path, checked.REMEDY) from None
