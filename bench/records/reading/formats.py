"""Readers of binary formats: spreadsheets, MATLAB, NumPy, Parquet, universal files, TDMS and sound.

The files are parsed by libraries; this module limits the size and selects the columns. Sizes are checked before memory
is allocated.
"""

from __future__ import annotations

import importlib
import io
import logging
import math
import os
import warnings
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bench.contract.problem import MIN_SAMPLES
from bench.errors import InputError
from bench.records.reading.grid import LineAbove, bounds_of, make_table, row_of, shape_of
from bench.records.reading.headings import Column, column_of
from bench.records.reading.table import MAX_COLUMNS, PREAMBLE, Spectrum, Table, check_size
from bench.records.reading.units import Measures, unit_of

Reader = Callable[[bytes, Path], Table]
"""Function of the bytes of a file and its path that returns its table; raises InputError."""
MAX_UNPACKED, MAX_WORKBOOK = 256 * 2**20, 64 * 2**20
"""Largest uncompressed sizes (bytes); openpyxl needs about a microsecond per byte of a workbook."""
NESTED = 8
"""Largest depth of nested structures."""


def optional(package: str, source: Path) -> Any:
    """Import a package that a file format needs; raise InputError with the command to install it if it is missing."""
    try:
        return importlib.import_module(package)
    except ImportError:
        remedy = f'this file format needs the package {package}: pip install "vibration-bench[files]"'
        raise InputError("data", source, remedy) from None


def read_zip(data: bytes, source: Path) -> Table:
    """Read a format that is a zip archive: a workbook (xlsx) or NumPy arrays (npz)."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        names = archive.namelist()
        unpacked = sum(info.file_size for info in archive.infolist())
    workbook = any(name.startswith("xl/") for name in names)
    most = MAX_WORKBOOK if workbook else MAX_UNPACKED
    if unpacked > most:
        raise InputError("data", source, f"more than {most // 2**20} MiB uncompressed; shorten the record")
    if workbook:
        return _read_xlsx(data, source)
    if names and all(name.endswith(".npy") for name in names):
        return read_numpy(data, source)
    raise InputError("data", source, "zip files are not supported; extract a file")


# spreadsheets


def _read_xlsx(data: bytes, source: Path) -> Table:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # for styles and checks that openpyxl does not support
        book = optional("openpyxl", source).load_workbook(io.BytesIO(data), read_only=True, data_only=True)
        for sheet in book.worksheets:
            sheet.reset_dimensions()  # the stated dimensions may be far too large
        return _first_table({sheet.title: sheet.iter_rows(values_only=True) for sheet in book.worksheets}, source)


def read_xls(data: bytes, source: Path) -> Table:
    """Read a workbook of the old format (xls)."""
    xlrd = optional("xlrd", source)
    with open(os.devnull, "w", encoding="utf-8") as log:
        book = xlrd.open_workbook(file_contents=data, logfile=log, ragged_rows=True)

    def values(row: Sequence[Any]) -> list[object]:
        known = (xlrd.XL_CELL_NUMBER, xlrd.XL_CELL_DATE, xlrd.XL_CELL_TEXT)
        return [cell.value if cell.ctype in known else None for cell in row]  # error cells have a numeric value, too

    return _first_table({sheet.name: map(values, sheet.get_rows()) for sheet in book.sheets()}, source)


def _first_table(sheets: Mapping[str, Iterable[Sequence[object]]], source: Path) -> Table:
    """Return the table of the first sheet that has one; a note names it if there are several sheets."""
    for title, sheet in sheets.items():
        place = f"{source} sheet '{title}'"
        texts = _texts(sheet, place)
        rows = [row_of(i, line) for i, line in texts.items()]
        shape = shape_of(rows)
        if shape.n >= MIN_SAMPLES:
            first, last = bounds_of(rows, shape, place)
            above = (LineAbove([texts[row.line]]) for row in reversed(rows[:first]))
            table = make_table(rows, shape, (first, last), above, place)
            more = (f"the workbook has {len(sheets)} sheets; '{title}' was read",)
            return replace(table, notes=more + table.notes) if len(sheets) > 1 else table
    raise InputError("data", source, "no sheet has rows of numbers; a table of times and values is needed")


def _texts(sheet: Iterable[Sequence[object]], place: str) -> dict[int, list[str]]:
    """Return the cells of the non-empty rows of a sheet as text, by number of the row."""
    lines: dict[int, list[str]] = {}
    for i, values in enumerate(sheet, 1):
        cells = ["" if value is None else str(value) for value in values[:MAX_COLUMNS]]
        if any(value not in (None, "") for value in values[MAX_COLUMNS:]):
            raise InputError("data", f"{place} row {i}", f"more than {MAX_COLUMNS} columns; delete those not needed")
        if any(cells):
            lines[i] = cells
            check_size(len(lines) - PREAMBLE, place)
    width = max(map(len, lines.values()), default=0)
    return {i: line + [""] * (width - len(line)) for i, line in lines.items()}


# named arrays


def read_mat(data: bytes, source: Path) -> Table:
    """Read the variables of a MATLAB file up to version 7; members of structures are named ``structure.member``."""
    from scipy.io import loadmat, whosmat  # slow to import

    if data[:10] == b"MATLAB 7.3" or data[:8] == b"\x89HDF\r\n\x1a\n":
        raise InputError("data", source, "HDF5 (MATLAB 7.3) is not supported; save it with save(…, '-v7')")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # for objects that SciPy skips
        check_size(0, source, sum(math.prod(shape) for _, shape, _ in whosmat(io.BytesIO(data))))
        loaded = loadmat(io.BytesIO(data), squeeze_me=True, struct_as_record=False)
    return _variables({name: value for name, value in _members(loaded) if not name.startswith("__")}, source)


def _members(variables: Mapping[str, object], depth: int = 0) -> Iterator[tuple[str, object]]:
    for name, value in variables.items():
        fields = getattr(value, "_fieldnames", None)
        if fields is None:
            yield name, value
        elif depth < NESTED:
            yield from _members({f"{name}.{field}": getattr(value, field) for field in fields}, depth + 1)


def read_numpy(data: bytes, source: Path) -> Table:
    """Read the arrays of an npz file, or the columns of an npy file; pickled objects are rejected."""
    try:
        loaded = np.load(io.BytesIO(data), allow_pickle=False)
        if not isinstance(loaded, np.ndarray):
            return _variables({name: loaded[name] for name in loaded.files}, source)
    except ValueError as error:
        if "allow_pickle" in str(error):
            remedy = "it contains Python objects, which are not loaded for security; save arrays of numbers"
            raise InputError("data", source, remedy) from None
        raise
    fields = {name: loaded[name] for name in loaded.dtype.names or ()}
    return _variables(fields or {"": loaded}, source, named=False)


def _variables(variables: Mapping[str, object], source: Path, named: bool = True) -> Table:
    """Return the table of the numerical variables; the shapes of all variables are listed in errors."""
    arrays = {name: np.asarray(value) for name, value in variables.items()}
    numbers = {name: array for name, array in arrays.items() if array.dtype.kind in "biufc"}
    check_size(0, source, sum(array.size for array in arrays.values()))
    columns = [column for name, array in numbers.items() for column in _columns(name, np.squeeze(array), source)]
    shapes = [f"{name} {array.shape if name in numbers else '(no numbers)'}" for name, array in arrays.items()]
    return Table(tuple(columns), contents=f"variables {', '.join(shapes)}" if named else "")


def _columns(name: str, array: np.ndarray, source: Path) -> Iterator[Column]:
    """Yield a vector as a column, and the vectors along the longer side of a matrix as ``name[0]``, ``name[1]``, ..."""
    if array.size < MIN_SAMPLES or array.ndim not in (1, 2):
        return
    check_size(max(array.shape), source)
    flaw = "complex numbers" if array.dtype.kind == "c" else ""
    values = np.real(array).astype(float)
    if values.ndim == 1:
        yield column_of(name, values, flaw=flaw)
    elif min(values.shape) <= MAX_COLUMNS:
        for j, part in enumerate(values.T if values.shape[0] >= values.shape[1] else values):
            yield column_of(f"{name}[{j}]" if name else "", part.copy(), flaw=flaw)


# channels


def read_parquet(data: bytes, source: Path) -> Table:
    """Read the numerical columns of a Parquet file; the metadata of a field may contain its unit."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    file = pq.ParquetFile(io.BytesIO(data))
    kinds = (pa.types.is_integer, pa.types.is_floating, pa.types.is_decimal)
    fields = list(file.schema_arrow)
    numbers = [field.name for field in fields if any(kind(field.type) for kind in kinds)]
    check_size(file.metadata.num_rows, source, file.metadata.num_rows * len(numbers))
    columns = []
    for field in fields:
        unit = (field.metadata or {}).get(b"unit", b"").decode("utf-8", "replace")
        if field.name in numbers:
            values = file.read(columns=[field.name]).column(0).cast(pa.float64()).to_numpy()
            columns.append(column_of(field.name, values, unit))
        else:
            columns.append(_flawed(field.name, f"not numbers: {field.type}"[:40]))
    return Table(tuple(columns))


def _flawed(name: str, flaw: str) -> Column:
    """Return a column that is listed but cannot be used."""
    return column_of(name, np.full(1, np.nan), flaw=flaw)


def read_sound(data: bytes, source: Path) -> Table:
    """Read the channels of a sound file (wav, flac, aiff), as fractions of full scale."""
    with optional("soundfile", source).SoundFile(io.BytesIO(data)) as file:
        check_size(file.frames, source, file.frames * file.channels)
        values, clock = file.read(always_2d=True), np.arange(file.frames) / file.samplerate
    columns = [column_of(f"channel {i}", channel, times=clock) for i, channel in enumerate(values.T.copy(), 1)]
    return Table(tuple(columns), ("samples of the sound file are fractions of full scale",))


def read_tdms(data: bytes, source: Path) -> Table:
    """Read the channels of a TDMS file, with their times if they are waveforms."""
    nptdms = optional("nptdms", source)
    nptdms.log.log_manager.set_level(logging.CRITICAL)  # errors are reported by exceptions
    columns = []
    with nptdms.TdmsFile.open(io.BytesIO(data)) as file:
        channels = [channel for group in file.groups() for channel in group.channels()]
        check_size(max(map(len, channels), default=0), source, sum(map(len, channels)))
        for channel in channels:
            if channel.dtype.kind not in "biuf":
                columns.append(_flawed(channel.name, "not numbers"))
                continue
            properties = channel.properties
            unit = str(properties.get("unit_string") or properties.get("NI_UnitDescription") or "")
            step, start = properties.get("wf_increment", 0.0), properties.get("wf_start_offset", 0.0)
            times = start + step * np.arange(len(channel)) if step > 0 else None
            columns.append(column_of(channel.name, np.asarray(channel[:], float), unit, times=times))
    return Table(tuple(columns))


DATA_SET, UNITS, SI = 58, 164, 1
"""Types of data sets (function, units), and the code of SI units."""
GENERAL, TIME_RESPONSE, FREQUENCY_RESPONSE, UNKNOWN, TIME, FREQUENCY = 0, 1, 4, 0, 17, 18
"""Types of functions and of abscissas."""
COMPLEX = (5, 6)
"""Types of complex values, in single and double precision."""
ORDINATES: dict[int, Measures] = {
    8: "displacement", 9: "force", 11: "velocity", 12: "acceleration", 13: "force",
}  # fmt: skip
"""Quantities by type of ordinate; 9 is a reaction force, 13 an excitation force."""
SI_UNITS = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s²", "force": "N"}
DIRECTIONS = ("", "X", "Y", "Z", "RX", "RY", "RZ")


def read_universal(data: bytes, source: Path) -> Table:
    """Read the data sets 58 of a universal file (text or binary): time records and frequency responses."""
    file = optional("pyuff", source).UFF(str(source))
    types = [int(kind) for kind in file.get_set_types()]
    heads = {i: file.read_sets(i, header_only=True) for i, kind in enumerate(types) if kind == DATA_SET}
    sizes = [int(head["num_pts"]) for head in heads.values()]
    check_size(max(sizes, default=0), source, sum(sizes))
    columns = [_data_set(file, i, head, source) for i, head in heads.items()]
    if not columns:
        present = ", ".join(map(str, sorted(set(types)))) or "none"
        raise InputError("data", source, f"no data set of type {DATA_SET}; types in the file: {present}")
    si = UNITS in types and int(file.read_sets(types.index(UNITS))["units_code"]) == SI
    responses = {i: head for i, head in heads.items() if int(head["func_type"]) == FREQUENCY_RESPONSE}
    spectra = [_spectrum(file, i, head, source, si) for i, head in responses.items()]
    if all(column.flaw for column in columns) and not spectra:
        remedy = f"no data set is a time record: {columns[0].flaw}; export time responses"
        raise InputError("data", source, remedy)
    return Table(tuple(columns), spectra=tuple(spectra))


def _text(head: Mapping[str, Any], key: str) -> str:
    text = " ".join(str(head[key]).split())
    return "" if text.upper() == "NONE" else text


def _body(file: Any, i: int, head: Mapping[str, Any], source: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return abscissas and values of a data set; raises InputError if their number differs from the header."""
    body, n = file.read_sets(i), int(head["num_pts"])
    if len(body["data"]) != n or len(body["x"]) != n:
        remedy = f"the header states {n} values; export the file again"
        raise InputError("data", f"{source} data set {i} of {len(body['data'])} values", remedy)
    return np.asarray(body["x"], float), np.asarray(body["data"])


def _data_set(file: Any, i: int, head: Mapping[str, Any], source: Path) -> Column:
    label, unit, entity, clock = (
        _text(head, key)
        for key in ("ordinate_axis_lab", "ordinate_axis_units_lab", "rsp_ent_name", "abscissa_axis_units_lab")
    )
    node = f"node {head['rsp_node']}" if head["rsp_node"] else entity
    name = f"{label} {node}".strip() or str(head["id1"]).strip()
    flaws = {
        f"not a time response (function type {head['func_type']})": head["func_type"] not in (GENERAL, TIME_RESPONSE),
        f"not a function of time (abscissa type {head['abscissa_spec_data_type']})":
            head["abscissa_spec_data_type"] not in (UNKNOWN, TIME),
        f"times are in {clock}, not in s": clock.lower() not in ("", "s", "sec"),
        "complex values": head["ord_data_type"] in COMPLEX,
    }  # fmt: skip
    if any(flaws.values()):
        return _flawed(name, next(flaw for flaw, holds in flaws.items() if holds))
    times, values = _body(file, i, head, source)
    measures = ORDINATES.get(int(head["ordinate_spec_data_type"]))
    return column_of(name, values.astype(float), unit, measures, times)


def _spectrum(file: Any, i: int, head: Mapping[str, Any], source: Path, si: bool) -> Spectrum:
    """Return a frequency response with its units, stated as ``m/s^2`` and ``N`` or as ``(m/s^2)/N``."""
    axis, unit, per = (_text(head, f"{key}_units_lab") for key in ("abscissa_axis", "ordinate_axis", "orddenom_axis"))
    remedy = {
        "the values are real; export complex frequency responses":
            head["ord_data_type"] not in COMPLEX,
        "not a function of frequency in Hz; export frequency responses in Hz":
            head["abscissa_spec_data_type"] not in (UNKNOWN, FREQUENCY) or axis.lower() not in ("", "hz"),
    }  # fmt: skip
    for reason, holds in remedy.items():
        if holds:
            raise InputError("data", f"{source} data set {i}", reason)
    if not per and unit_of(unit) is None and "/" in unit:
        unit, per = unit.rsplit("/", 1)
    frequencies, values = _body(file, i, head, source)
    measures, force = (ORDINATES.get(int(head[f"{key}_spec_data_type"])) for key in ("ordinate", "orddenom"))
    units = SI_UNITS if si else {}
    response = column_of(_point(head, "rsp"), values, unit or units.get(measures or "", ""), measures, frequencies)
    per = per or units.get("force", "")
    return Spectrum(response, column_of("", np.empty(0), per, force), _point(head, "ref"))


def _point(head: Mapping[str, Any], which: str) -> str:
    """Return node and direction, such as ``3 +Z``, or the name of the entity."""
    direction = int(head[f"{which}_dir"])
    axis = DIRECTIONS[abs(direction)] if abs(direction) < len(DIRECTIONS) else ""
    node = str(head[f"{which}_node"]) if head[f"{which}_node"] else _text(head, f"{which}_ent_name")
    return f"{node} {'-' if direction < 0 else '+'}{axis}" if axis else node
