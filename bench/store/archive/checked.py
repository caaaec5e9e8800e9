"""Parquet files that carry a checksum of themselves, in what a Parquet file says of itself beside its table.

The SHA-256 is that of the whole file with zeros in the place of its own digits.
"""

from __future__ import annotations

import hashlib
import os
import re
import uuid
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq

from bench.errors import InputError
from bench.store.seal import read_regular

FORMAT = 2
WITHOUT_CHECKSUM = 1
"""The format before: the same columns in a file without a checksum."""
REMEDY = "not a whole file of the archive; fetch it again"
FORMAT_KEY, CHECKSUM_KEY = "vibration-bench archive", "vibration-bench sha256"
BLANK = b"0" * 64
DIGITS = re.compile(re.escape(CHECKSUM_KEY.encode()) + rb"[^0-9a-f]{1,8}([0-9a-f]{64})")
"""The digits stand behind their key, with a few bytes of Parquet's own between."""


class Content(NamedTuple):
    """The bytes of a file, what it says of itself, and whether its checksum agrees with them or it has none."""

    buffer: pa.Buffer
    says: Mapping[str, str]
    checked: bool


def write(
    path: Path,
    table: pa.Table,
    says: Mapping[str, str],
    check: Callable[[Path], None] = lambda written: None,
    **options: Any,
) -> None:
    """Write a table as a file, whole, in the place of any before it.

    Args:
        path: The file.
        table: Its only row group.
        says: What else the file says of itself.
        check: Is called with the written file before it takes its place, and raises where that is wrong.
        **options: Of :class:`pyarrow.parquet.ParquetWriter`.
    """
    temporary = path.with_name(f"{path.name}.{uuid.uuid4().hex}.tmp")
    try:
        with pq.ParquetWriter(temporary, table.schema, store_schema=False, **options) as writer:
            writer.write_table(table, row_group_size=max(1, table.num_rows))
            writer.add_key_value_metadata({FORMAT_KEY: str(FORMAT), **says, CHECKSUM_KEY: BLANK.decode()})
        content = temporary.read_bytes()
        place = _place(content)
        assert place is not None, "the key has just been written"
        with temporary.open("rb+") as file:
            file.seek(place)
            file.write(_digest(content, place))
            file.flush()
            os.fsync(file.fileno())
        check(temporary)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def read(path: Path, older: bool = False) -> Content:
    """A file that agrees with its checksum; if ``older``, also one of the format that had none, as it is.

    Raises InputError for any other.
    """
    try:
        content = read_regular(path)
    except OSError as error:
        raise InputError("archive", path, f"{REMEDY} ({error.strerror})") from None
    place = _place(content)
    if place is not None and content[place : place + len(BLANK)] != _digest(content, place):
        raise InputError("archive", path, f"{REMEDY} (its checksum is not that of its content)")
    try:
        stated = pq.read_metadata(pa.BufferReader(content)).metadata or {}
        says = {key.decode(): text.decode() for key, text in stated.items()}
        found = int(says.get(FORMAT_KEY, WITHOUT_CHECKSUM))
    except (pa.ArrowException, OSError, ValueError):
        raise InputError("archive", path, REMEDY) from None
    agrees = place is not None
    if (found, agrees) == (FORMAT, True) or (older and (found, agrees) == (WITHOUT_CHECKSUM, False)):
        return Content(pa.py_buffer(content), says, agrees)
    remedy = {
        FORMAT: "its checksum is gone; fetch it again",
        WITHOUT_CHECKSUM: "it has no checksum: python -m bench.publish seal=true takes it as it is",
    }.get(found, "fetch the archive again")
    raise InputError("archive", path, f"an archive of format {found}, this version reads {FORMAT}; {remedy}")


def _place(content: bytes) -> int | None:
    """Where the digits of a file's checksum are; what a Parquet file says of itself stands at its end."""
    found = DIGITS.match(content, max(0, content.rfind(CHECKSUM_KEY.encode())))
    return found.start(1) if found else None


def _digest(content: bytes, place: int) -> bytes:
    """The digits of a file that has its own at a place."""
    digest = hashlib.sha256(content[:place])
    digest.update(BLANK)
    digest.update(content[place + len(BLANK) :])
    return digest.hexdigest().encode()
