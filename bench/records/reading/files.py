"""A file of any kind to a table: what it is, is seen from its first bytes, not from its name."""

from __future__ import annotations

import gzip
import hashlib
import io
import re
import stat
import zipfile
import zlib
from pathlib import Path

from bench.errors import InputError
from bench.records.reading.arrays import read_mat, read_npy, read_npz, read_parquet
from bench.records.reading.spreadsheets import read_workbook
from bench.records.reading.table import Table
from bench.records.reading.tdms import read_tdms
from bench.records.reading.text import read_text
from bench.records.reading.universal import read_universal

MAX_BYTES = 256 * 2**20
MAX_UNPACKED = MAX_BYTES


def read_file(path: Path) -> tuple[Table, str]:
    """The table in a file and the sha256 of its bytes.

    Raises:
        InputError: it is not there, too large, damaged, or of no kind that is read.
    """
    data = _bytes(path)
    try:
        table = _table(data, path)
    except InputError:
        raise
    except Exception as error:  # what damaged bytes raise in a library is anything
        reason = " ".join(str(error).split())[:80] or type(error).__name__
        raise InputError(
            "data", path, f"it is damaged or not of the kind it seems ({reason}); write it again"
        ) from None
    return table, hashlib.sha256(data).hexdigest()


def _bytes(path: Path) -> bytes:
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):  # a pipe is waited on, a device may have no end
            raise InputError("data", path, "cannot be read: it is a folder, a pipe or a device; name a file")
        size = status.st_size
        if size > MAX_BYTES:
            raise InputError("data", path, f"{size / 2**20:.0f} MiB; at most {MAX_BYTES // 2**20}, thin or cut it")
        data = path.read_bytes()
    except OSError as error:
        raise InputError("data", path, f"cannot be read: {error.strerror}") from None
    if not data:
        raise InputError("data", path, "the file is empty; a table of times and values is needed")
    return data


def _table(data: bytes, path: Path) -> Table:
    if data[:2] == b"\x1f\x8b":
        return read_text(_unzipped(data, path), path)
    if data[:4] == b"PK\x03\x04":
        return _zip(data, path)
    if data[:6] == b"\x93NUMPY":
        return read_npy(data, path)
    if data[:4] == b"PAR1":
        return read_parquet(data, path)
    if data[:6] == b"MATLAB" or data[:8] == b"\x89HDF\r\n\x1a\n" or path.suffix.lower() == ".mat":
        return read_mat(data, path)
    if data[:4] in (b"TDSm", b"TDSh"):
        return read_tdms(data, path)
    if data[:4] == b"\xd0\xcf\x11\xe0":
        raise InputError("data", path, "an old workbook (xls) is not read; save it as xlsx or csv")
    if _is_universal(data):
        return read_universal(path)
    return read_text(data, path)


def _is_universal(data: bytes) -> bool:
    """Whether it starts with the mark of a data set and the number of its type."""
    return re.match(rb"[\r\n]* {4}-1 *\r?\n {1,5}\d{1,4}[b \r\n]", data) is not None


def _unzipped(data: bytes, path: Path) -> bytes:
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as file:
            text = file.read(MAX_BYTES + 1)
    except (OSError, EOFError, zlib.error):
        raise InputError("data", path, "the gzip file is damaged; write it again") from None
    if len(text) > MAX_BYTES:
        raise InputError("data", path, f"more than {MAX_BYTES // 2**20} MiB when unzipped; thin or cut it")
    return text


def _zip(data: bytes, path: Path) -> Table:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        names = archive.namelist()
        unpacked = sum(info.file_size for info in archive.infolist())
    if unpacked > MAX_UNPACKED:
        raise InputError("data", path, f"more than {MAX_UNPACKED // 2**20} MiB when unzipped; thin or cut it")
    if any(name.startswith("xl/") for name in names):
        return read_workbook(data, path)
    if names and all(name.endswith(".npy") for name in names):
        return read_npz(data, path)
    raise InputError("data", path, "a zip file is not read; give one file out of it")
