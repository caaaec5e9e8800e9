"""Records that are no text: spreadsheets, MATLAB, NumPy, Parquet, universal files, TDMS and sound.

Libraries read them; here stands how much is read at most, and which of what they hold are columns. Sizes are checked
before anything of that size is in memory.
"""

from __future__ import annotations

import io
import logging
import math
import os
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.contract.problem import MIN_SAMPLES
from bench.errors import InputError
from bench.records.reading.grid import (
    NAN,
    Above,
    Cell,
    TableRow,
    bounds,
    cell_of,
    heading_above,
    make_table,
    row_of,
    shape_of,
    shown,
)
from bench.records.reading.table import MAX_COLUMNS, Column, Table, check_rows, check_values, optional
from bench.records.reading.units import Measures

Reader = Callable[[bytes, Path], Table]
"""From the bytes of a file and its path to its table."""
MAX_UNPACKED, MAX_WORKBOOK = 256 * 2**20, 64 * 2**20
"""Bytes; those of a workbook take openpyxl a microsecond each where it does not state its dimensions."""
MAX_CELLS = 3_000_000
"""Of a workbook, whose cells take some microseconds each."""
PREAMBLE = 1000
"""Rows of a sheet that need not be of the table."""
NESTED = 8
"""Structures in structures that are looked into."""


def read_zip(data: bytes, source: Path) -> Table:
    """Read what is a zip file inside: a workbook (xlsx) or NumPy arrays (npz). Raises InputError."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        names = archive.namelist()
        unpacked = sum(info.file_size for info in archive.infolist())
    workbook = any(name.startswith("xl/") for name in names)
    _check_unpacked(unpacked, source, MAX_WORKBOOK if workbook else MAX_UNPACKED)
    if workbook:
        return _read_xlsx(data, source)
    if names and all(name.endswith(".npy") for name in names):
        return read_numpy(data, source)
    raise InputError("data", source, "a zip file is not read; give one file out of it")


def _check_unpacked(size: int, source: Path, most: int) -> None:
    if size > most:
        raise InputError("data", source, f"more than {most // 2**20} MiB when unzipped; thin or cut it")


# spreadsheets


def _read_xlsx(data: bytes, source: Path) -> Table:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of styles and checks that openpyxl does not know
        book = optional("openpyxl", source).load_workbook(io.BytesIO(data), read_only=True, data_only=True)
        for sheet in book.worksheets:
            sheet.reset_dimensions()  # what is stated may be far more than there is
        return _first_table({sheet.title: sheet.iter_rows(values_only=True) for sheet in book.worksheets}, source)


def read_xls(data: bytes, source: Path) -> Table:
    """Read an old workbook. Raises InputError."""
    xlrd = optional("xlrd", source)
    with open(os.devnull, "w", encoding="utf-8") as log:
        book = xlrd.open_workbook(file_contents=data, logfile=log, ragged_rows=True)
    numbers = (xlrd.XL_CELL_NUMBER, xlrd.XL_CELL_DATE, xlrd.XL_CELL_TEXT)

    def rows(sheet: Any) -> Iterator[list[object]]:
        for i in range(sheet.nrows):
            yield [cell.value if cell.ctype in numbers else None for cell in sheet.row(i)]

    return _first_table({sheet.name: rows(sheet) for sheet in book.sheets()}, source)


def _first_table(sheets: Mapping[str, Iterable[Sequence[object]]], source: Path) -> Table:
    """Return the table of the first sheet that has one, and note which where there are more sheets."""
    for title, cells in sheets.items():
        rows = _rows(cells, source)
        shape = shape_of(rows)
        if not shape.numeric or shape.n < MIN_SAMPLES:
            continue
        first, last, notes = bounds(rows, shape, f"{source} sheet '{title}'")
        above = [Above([[shown(cell) for cell in row.cells]]) for row in reversed(rows[:first])]
        if len(sheets) > 1:
            notes.insert(0, f"the workbook has {len(sheets)} sheets; '{title}' is read")
        return make_table(rows[first:last], shape, heading_above(above, shape), notes)
    raise InputError("data", source, "no sheet has rows of numbers; a table of times and values is needed")


def _rows(sheet: Iterable[Sequence[object]], source: Path) -> list[TableRow]:
    lines: dict[int, list[Cell]] = {}
    held = 0
    for i, values in enumerate(sheet, 1):
        cells = [_cell(value) for value in values[:MAX_COLUMNS]]
        if any(value is not None for value in values[MAX_COLUMNS:]):
            raise InputError("data", f"{source} row {i}", f"cells beyond column {MAX_COLUMNS}; keep those that matter")
        held += len(cells)
        if held > MAX_CELLS:
            raise InputError(
                "data", source, f"more than {MAX_CELLS} cells; keep the columns that matter, as csv or npz"
            )
        check_rows(len(lines) - PREAMBLE, source)
        if any(isinstance(cell, str) or not math.isnan(cell) for cell in cells):
            lines[i] = cells
    width = max(map(len, lines.values()), default=0)
    return [row_of(i, cells + [NAN] * (width - len(cells))) for i, cells in lines.items()]


def _cell(value: object) -> Cell:
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    return NAN if value is None else cell_of(str(value))


# named arrays


def read_mat(data: bytes, source: Path) -> Table:
    """Read the variables of a MATLAB file up to version 7; members of structures are named ``structure.member``.

    Raises:
        InputError: it is of version 7.3, or too large.
    """
    from scipy.io import loadmat, whosmat  # slow to import, and few need it

    if data[:10] == b"MATLAB 7.3" or data[:8] == b"\x89HDF\r\n\x1a\n":
        raise InputError("data", source, "HDF5, as MATLAB 7.3 writes it, is not read; save it with save(…, '-v7')")
    _check_unpacked(_unpacked_mat(data), source, MAX_UNPACKED)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of objects that SciPy skips
        check_values(sum(math.prod(shape) for _, shape, _ in whosmat(io.BytesIO(data))), source)
        loaded = loadmat(io.BytesIO(data), squeeze_me=True, struct_as_record=False)
    return _variables({name: value for name, value in _members(loaded) if not name.startswith("__")}, source)


def _unpacked_mat(data: bytes) -> int:
    """Return the size of a file of version 5 with its packed elements (type 15) unpacked, up to a little too much."""
    order = ">" if data[126:128] == b"MI" else "<"
    size, place = 0, 128
    while place + 8 <= len(data) and size <= MAX_UNPACKED:
        kind, length = struct.unpack_from(order + "II", data, place)
        size += length
        if kind == 15:
            packed = zlib.decompressobj()
            rest = data[place + 8 : place + 8 + length]
            while rest and size <= MAX_UNPACKED:
                size += len(packed.decompress(rest, 2**24))
                rest = packed.unconsumed_tail
        place += 8 + length
    return size


def _members(variables: Mapping[str, object], depth: int = 0) -> Iterator[tuple[str, object]]:
    for name, value in variables.items():
        fields = getattr(value, "_fieldnames", None)
        if fields is None:
            yield name, value
        elif depth < NESTED:
            yield from _members({f"{name}.{field}": getattr(value, field) for field in fields}, depth + 1)


def read_numpy(data: bytes, source: Path) -> Table:
    """Read the arrays of an npz file, or the columns of an npy file; nothing pickled is opened. Raises InputError."""
    try:
        loaded = np.load(io.BytesIO(data), allow_pickle=False)
        if not isinstance(loaded, np.ndarray):
            return _variables({name: loaded[name] for name in loaded.files}, source)
    except ValueError as error:
        if "allow_pickle" in str(error):
            remedy = "it holds Python objects, which are never loaded; save arrays of numbers"
            raise InputError("data", source, remedy) from None
        raise
    if loaded.dtype.names:
        return _variables({name: loaded[name] for name in loaded.dtype.names}, source, named=False)
    return _variables({"": loaded}, source, named=False)


def _variables(variables: Mapping[str, object], source: Path, named: bool = True) -> Table:
    """Return the variables that can be signals, in their order, and the shapes of all for an error."""
    arrays = {name: np.asarray(value) for name, value in variables.items()}
    check_values(sum(array.size for array in arrays.values()), source)
    columns = [column for name, array in arrays.items() for column in _columns(name, array, source)]
    shapes = [f"{name} {array.shape if _numbers(array) else '(no numbers)'}" for name, array in arrays.items()]
    return Table(tuple(columns), contents=f"variables {', '.join(shapes)}" if named else "")


def _numbers(array: np.ndarray) -> bool:
    return array.dtype.kind in "biufc"


def _columns(name: str, array: np.ndarray, source: Path) -> Iterator[Column]:
    """A vector is a column; of a matrix each ``name[0]``, ``name[1]`` ... along its shorter side is one."""
    array = np.squeeze(array)
    if not _numbers(array) or array.size < MIN_SAMPLES or array.ndim not in (1, 2):
        return
    check_rows(max(array.shape), source)
    flaw = "complex numbers" if array.dtype.kind == "c" else ""
    values = np.real(array).astype(float)
    if values.ndim == 1:
        yield Column(name, values, flaw=flaw)
        return
    values = values if values.shape[0] >= values.shape[1] else values.T
    if values.shape[1] <= MAX_COLUMNS:
        for j in range(values.shape[1]):
            yield Column(f"{name}[{j}]" if name else "", np.ascontiguousarray(values[:, j]), flaw=flaw)


# channels, each with its head and its samples


@dataclass(frozen=True, eq=False)
class FileChannel:
    """The head of a channel of ``n`` samples, and how its values and times (None without) are read."""

    name: str
    n: int
    read: Callable[[], tuple[np.ndarray, np.ndarray | None]]
    unit: str = ""
    measures: Measures | None = None
    flaw: str = ""

    @property
    def column(self) -> Column:
        values, times = (np.full(1, np.nan), None) if self.flaw else self.read()
        return Column(self.name, np.asarray(values, dtype=float), self.unit, self.measures, times, self.flaw)


def _table(channels: Sequence[FileChannel], source: Path, notes: tuple[str, ...] = ()) -> Table:
    sizes = [channel.n for channel in channels if not channel.flaw]
    check_rows(max(sizes, default=0), source)
    check_values(sum(sizes), source)
    return Table(tuple(channel.column for channel in channels), notes)


def read_parquet(data: bytes, source: Path) -> Table:
    """Read the columns of numbers of a Parquet file; a field's metadata may hold its unit. Raises InputError."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    file = pq.ParquetFile(io.BytesIO(data))

    def channel(field: Any) -> FileChannel:
        unit = (field.metadata or {}).get(b"unit", b"").decode("utf-8", "replace")
        number = pa.types.is_integer(field.type) or pa.types.is_floating(field.type) or pa.types.is_decimal(field.type)
        flaw = "" if number else f"not numbers: {field.type}"[:40]

        def read() -> tuple[np.ndarray, None]:
            return file.read(columns=[field.name]).column(0).cast(pa.float64()).to_numpy(), None

        return FileChannel(field.name, file.metadata.num_rows, read, unit, flaw=flaw)

    return _table([channel(field) for field in file.schema_arrow], source)


def read_sound(data: bytes, source: Path) -> Table:
    """Read the channels of a sound file (wav, flac, aiff), in parts of full scale. Raises InputError."""
    sound = optional("soundfile", source)
    with sound.SoundFile(io.BytesIO(data)) as file:
        check_rows(file.frames, source)
        check_values(file.frames * file.channels, source)
        values, clock = file.read(always_2d=True), np.arange(file.frames) / file.samplerate
    columns = [Column(f"channel {i}", channel, times=clock) for i, channel in enumerate(values.T.copy(), 1)]
    return Table(tuple(columns), ("samples of a sound file are parts of its full scale",))


def read_tdms(data: bytes, source: Path) -> Table:
    """Read the channels of a TDMS file, with their times where a channel is a waveform. Raises InputError."""
    nptdms = optional("nptdms", source)
    nptdms.log.log_manager.set_level(logging.CRITICAL)  # what is wrong is said once, by the error

    def head(channel: Any) -> FileChannel:
        said = channel.properties
        unit = str(said.get("unit_string") or said.get("NI_UnitDescription") or "")
        step, start = said.get("wf_increment", 0.0), said.get("wf_start_offset", 0.0)

        def read() -> tuple[np.ndarray, np.ndarray | None]:
            return channel[:], start + step * np.arange(len(channel)) if step > 0 else None

        flaw = "" if channel.dtype.kind in "biuf" else "not numbers"
        return FileChannel(channel.name, len(channel), read, unit, flaw=flaw)

    with nptdms.TdmsFile.open(io.BytesIO(data)) as file:
        return _table([head(channel) for group in file.groups() for channel in group.channels()], source)


DATA_SET, GENERAL, TIME_RESPONSE, UNKNOWN, TIME = 58, 0, 1, 0, 17
"""Type of a data set; types of function, and of abscissa, that may be a record in time."""
ORDINATES: dict[int, Measures] = {
    8: "displacement", 9: "force", 11: "velocity", 12: "acceleration", 13: "force",
}  # fmt: skip
"""Types of an ordinate: 9 is a reaction force, 13 an excitation."""


def read_universal(data: bytes, source: Path) -> Table:
    """Read the data sets 58 of a universal file, text or binary, each with its own times.

    Raises:
        InputError: none is a record in time, or one is cut short.
    """
    file = optional("pyuff", source).UFF(str(source))
    types = [int(kind) for kind in file.get_set_types()]
    channels = [_data_set(file, i, source) for i, kind in enumerate(types) if kind == DATA_SET]
    if not channels:
        held = ", ".join(map(str, sorted(set(types)))) or "none"
        raise InputError("data", source, f"a data set {DATA_SET} is needed; it holds {held}")
    if all(channel.flaw for channel in channels):
        remedy = f"no data set is a record in time: {channels[0].flaw}; export time responses"
        raise InputError("data", source, remedy)
    return _table(channels, source)


def _data_set(file: Any, i: int, source: Path) -> FileChannel:
    head = file.read_sets(i, header_only=True)
    label, unit, entity, clock = (
        "" if str(head[key]).strip().upper() == "NONE" else " ".join(str(head[key]).split())
        for key in ("ordinate_axis_lab", "ordinate_axis_units_lab", "rsp_ent_name", "abscissa_axis_units_lab")
    )
    node = f"node {head['rsp_node']}" if head["rsp_node"] else entity
    name = f"{label} {node}".strip() or str(head["id1"]).strip()
    n, flaw = int(head["num_pts"]), ""
    if head["func_type"] not in (GENERAL, TIME_RESPONSE):
        flaw = f"a spectrum or another function (type {head['func_type']})"
    elif head["abscissa_spec_data_type"] not in (UNKNOWN, TIME):
        flaw = f"not over time (abscissa type {head['abscissa_spec_data_type']})"
    elif clock not in ("", "s", "sec", "S", "SEC"):
        flaw = f"its times are in {clock}, not in s"
    elif head["ord_data_type"] in (5, 6):
        flaw = "complex values"

    def read() -> tuple[np.ndarray, np.ndarray]:
        body = file.read_sets(i)
        if len(body["data"]) != n:
            remedy = f"{n} values are announced; write the file again"
            raise InputError("data", f"{source} data set {i} of {len(body['data'])} values", remedy)
        return body["data"], np.asarray(body["x"], float)

    return FileChannel(name, n, read, unit, ORDINATES.get(int(head["ordinate_spec_data_type"])), flaw)
