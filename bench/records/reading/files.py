"""Reading of files of any format, which is detected by the first bytes rather than the name.

Compressed and large files are read in a separate process with limits of time and memory; for limits on the size of the
content see ``formats``.
"""

from __future__ import annotations

import gzip
import hashlib
import io
import multiprocessing
import re
import stat
import zlib
from pathlib import Path

from bench.errors import InputError
from bench.isolation.limits import limit_memory
from bench.isolation.processes import Died
from bench.records.reading import formats
from bench.records.reading.table import Table
from bench.records.reading.text import read_text
from bench.records.workers import Workers

MAX_BYTES = 256 * 2**20
"""Largest size of a file, compressed or uncompressed (bytes)."""
SMALL = 4 * 2**20
"""Largest text or array that is read in the calling process (bytes); it needs up to twenty times its size in memory."""
MEMORY_MB, TIME_S = 1500.0, 120.0
"""Limits of the reading process, about twice the needs of the largest record."""


def read_file(path: Path) -> tuple[Table, str]:
    """Return the table in a file and the sha256 of its bytes.

    Raises:
        InputError: The file is missing, too large, damaged, or of an unknown format.
    """
    data = _bytes(path)
    plain = len(data) <= SMALL and _reader(data, path) in (read_text, formats.read_numpy)
    direct = plain or multiprocessing.current_process().daemon  # a worker has limits already and may not start others
    return (_table(data, path) if direct else _table_of_child(path)), hashlib.sha256(data).hexdigest()


def _bytes(path: Path) -> bytes:
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):  # reading a pipe may block, and a device may have no end
            raise InputError("data", path, "cannot be read: it is a folder, a pipe or a device; name a file")
        if (size := status.st_size) > MAX_BYTES:
            raise InputError("data", path, f"{size / 2**20:.0f} MiB; at most {MAX_BYTES // 2**20}: shorten the record")
        data = path.read_bytes()
    except OSError as error:
        raise InputError("data", path, f"cannot be read: {error.strerror}") from None
    if not data:
        raise InputError("data", path, "the file is empty; a table of times and values is needed")
    return data


def _reader(data: bytes, path: Path) -> formats.Reader:
    matlab = formats.read_mat if path.suffix.lower() == ".mat" else read_text
    return next((reader for magic, reader in MAGIC.items() if re.match(magic, data)), matlab)


def _table(data: bytes, path: Path) -> Table:
    try:
        return _reader(data, path)(data, path)
    except InputError:
        raise
    except MemoryError:
        raise _too_large(path) from None
    except Exception as error:  # libraries raise any exception for damaged files
        reason = " ".join(str(error).split())[:80] or type(error).__name__
        remedy = f"the file is damaged or not of the format it seems ({reason}); export it again"
        raise InputError("data", path, remedy) from None


def _table_of_child(path: Path) -> Table:
    with Workers(preload=()) as workers:
        try:
            table: Table = workers.submit(TIME_S, _limited, path, MEMORY_MB, memory_mb=MEMORY_MB).result()
        except Died as died:
            if died.reason in ("oom", "timeout"):
                raise _too_large(path) from None
            raise InputError("data", path, f"the file is damaged: {died.message}; export it again") from None
    return table


def _limited(path: Path, memory_mb: float) -> Table:
    """Read a file in a worker process."""
    limit_memory(memory_mb)
    return _table(_bytes(path), path)


def _too_large(path: Path) -> InputError:
    remedy = f"reading needs more than {MEMORY_MB:g} MB or {TIME_S:g} s; export the needed columns as csv or npz"
    return InputError("data", path, remedy)


def _read_gzip(data: bytes, source: Path) -> Table:
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as file:
            text = file.read(MAX_BYTES + 1)
    except (OSError, EOFError, zlib.error):
        raise InputError("data", source, "the gzip file is damaged; compress it again") from None
    if len(text) > MAX_BYTES:
        raise InputError("data", source, f"more than {MAX_BYTES // 2**20} MiB uncompressed; shorten the record")
    return read_text(text, source)


MAGIC: dict[bytes, formats.Reader] = {
    rb"\x1f\x8b": _read_gzip,
    rb"PK\x03\x04": formats.read_zip,
    rb"\x93NUMPY": formats.read_numpy,
    rb"PAR1": formats.read_parquet,
    rb"MATLAB|\x89HDF\r\n\x1a\n": formats.read_mat,
    rb"TDS[mh]": formats.read_tdms,
    rb"\xd0\xcf\x11\xe0": formats.read_xls,
    rb"RIFF....WAVE|RF64|fLaC|FORM....AIF": formats.read_sound,
    rb"[\r\n]* {4}-1 *\r?\n {1,5}\d{1,4}[b \r\n]": formats.read_universal,
}
"""Readers by pattern of a file's first bytes; a universal file starts with the delimiter and type of a data set."""
