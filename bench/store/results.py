"""Files of task results: one file per task, written atomically, with a checksum.

A file is named by the key of its task and ends with the SHA-256 of its content. The task of a damaged file is computed
again.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

from bench.errors import InputError
from bench.files import read_regular, write_whole

DIGEST_BYTES = 32


def result_path(folder: Path, key: str) -> Path:
    """Return the path of a result."""
    return folder / f"{key}.result"


def read_result(folder: Path, key: str) -> bytes | None:
    """Return the content of a result; None if it is missing or damaged."""
    try:
        whole = read_regular(result_path(folder, key))
    except OSError:
        return None
    content, digest = whole[:-DIGEST_BYTES], whole[-DIGEST_BYTES:]
    return content if hashlib.sha256(content).digest() == digest else None


def write_result(folder: Path, key: str, content: bytes) -> None:
    """Write the content of a result atomically; raises InputError if the folder cannot be written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(result_path(folder, key), content + hashlib.sha256(content).digest())
    except OSError as error:
        raise InputError("store", folder, f"cannot be written: {error.strerror}") from None
