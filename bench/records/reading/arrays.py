"""Records as named arrays: MATLAB (mat), NumPy (npz, npy) and Parquet files."""

from __future__ import annotations

import io
import warnings
import zipfile
from collections.abc import Iterator, Mapping
from typing import IO

import numpy as np

from bench.contract.problem import MIN_SAMPLES
from bench.errors import InputError
from bench.records.reading.table import MAX_ROWS, Column, Table, check_rows

MAX_COLUMNS = 64
"""Of one array; a wider one is a picture or a matrix, no set of signals."""
MAX_VALUES = MAX_ROWS * MAX_COLUMNS


def read_mat(data: bytes, source: object) -> Table:
    """The variables of a MATLAB file up to version 7; members of structures are named ``structure.member``.

    Raises:
        InputError: it is of version 7.3, or its arrays are too large.
    """
    from scipy.io import loadmat, whosmat  # slow to import, and few need it

    if data[:10] == b"MATLAB 7.3" or data[:8] == b"\x89HDF\r\n\x1a\n":
        raise InputError("data", source, "HDF5, as MATLAB 7.3 writes it, is not read; save it with save(…, '-v7')")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of objects that SciPy skips
        for name, shape, _ in whosmat(io.BytesIO(data)):
            _check_size(name, shape, source)
        loaded = loadmat(io.BytesIO(data), squeeze_me=True, struct_as_record=False)
    return _table({name: value for name, value in _members(loaded) if not name.startswith("__")})


def _members(variables: Mapping[str, object], depth: int = 0) -> Iterator[tuple[str, object]]:
    for name, value in variables.items():
        fields = getattr(value, "_fieldnames", None)
        if fields is None:
            yield name, value
        elif depth < 8:
            yield from _members({f"{name}.{field}": getattr(value, field) for field in fields}, depth + 1)


def read_npz(data: bytes, source: object) -> Table:
    """The arrays of an npz file; nothing pickled is ever opened. Raises InputError."""
    arrays = {}
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        for info in archive.infolist():
            if info.filename.endswith(".npy"):
                with archive.open(info) as file:
                    arrays[info.filename.removesuffix(".npy")] = _npy(file, source)
    return _table(arrays)


def read_npy(data: bytes, source: object) -> Table:
    """The columns of one array, by name where it has fields. Raises InputError."""
    array = _npy(io.BytesIO(data), source)
    if array.dtype.names:
        return _table({name: array[name] for name in array.dtype.names})
    return Table(tuple(_columns("", array)))


def _npy(file: IO[bytes], source: object) -> np.ndarray:
    version = np.lib.format.read_magic(file)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, by_column, dtype = read_header(file)
    _check_size("array", shape, source)
    if dtype.hasobject:
        raise InputError("data", source, "it holds Python objects, which are never loaded; save arrays of numbers")
    wanted = int(np.prod(shape, dtype=float)) * dtype.itemsize
    array = np.frombuffer(file.read(wanted), dtype)
    return array.reshape(shape, order="F" if by_column else "C")


def read_parquet(data: bytes, source: object) -> Table:
    """The columns of a Parquet file; a unit may stand in the metadata of a field. Raises InputError."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    file = pq.ParquetFile(io.BytesIO(data))
    check_rows(file.metadata.num_rows, source)
    table = file.read()
    columns = []
    for field, chunks in zip(table.schema, table.columns, strict=True):
        kind, unit = field.type, (field.metadata or {}).get(b"unit", b"").decode("utf-8", "replace")
        if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind):
            values = np.asarray(chunks.cast(pa.float64()).to_numpy(), dtype=float)
            columns.append(Column(field.name, values, unit))
        else:
            columns.append(Column(field.name, np.full(len(chunks), np.nan), unit, flaw=f"not numbers: {kind}"[:40]))
    return Table(tuple(columns))


def _check_size(name: str, shape: tuple[int, ...], source: object) -> None:
    check_rows(max(shape, default=0), source)
    if np.prod(shape, dtype=float) > MAX_VALUES:
        raise InputError("data", source, f"{name} of shape {shape} is too large; at most {MAX_VALUES} values")


def _table(variables: Mapping[str, object]) -> Table:
    """The variables that can be signals, in their order, and the shapes of all for an error."""
    columns: list[Column] = []
    shapes = []
    for name, value in variables.items():
        array = np.asarray(value)
        shapes.append(f"{name} {array.shape if array.dtype.kind in 'biufc' else '(no numbers)'}")
        columns += _columns(name, array)
    return Table(tuple(columns), contents=f"variables {', '.join(shapes)}")


def _columns(name: str, array: np.ndarray) -> Iterator[Column]:
    """A vector is a column; of a matrix each ``name[0]``, ``name[1]`` ... along its shorter side is one."""
    array = np.squeeze(array)
    if array.dtype.kind not in "biufc" or array.size < MIN_SAMPLES or array.ndim not in (1, 2):
        return
    flaw = "complex numbers" if array.dtype.kind == "c" else ""
    values = np.real(array).astype(float)
    if values.ndim == 1:
        yield Column(name, values, flaw=flaw)
        return
    values = values if values.shape[0] >= values.shape[1] else values.T
    if values.shape[1] <= MAX_COLUMNS:
        for j in range(values.shape[1]):
            yield Column(f"{name}[{j}]" if name else "", np.ascontiguousarray(values[:, j]), flaw=flaw)
