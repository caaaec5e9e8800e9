"""Reading of regular files, and atomic writing."""

from __future__ import annotations

import contextlib
import errno
import os
import stat
import uuid
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO

TEMPORARY = ".tmp"
"""Suffix of files being written; a killed process may leave such a file."""


def open_regular(path: Path) -> BinaryIO:
    """Open a file for reading. Raises OSError, also for a device or a pipe, which may never end."""
    handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise OSError(errno.EINVAL, "not a regular file", str(path))
    return os.fdopen(handle, "rb")


def read_regular(path: Path) -> bytes:
    """Return the content of a file. Raises OSError, as :func:`open_regular`."""
    with open_regular(path) as file:
        return file.read()


def write_whole(path: Path, content: bytes) -> None:
    """Write a file atomically, see :func:`write_together`."""
    write_together({path: content})


def write_together(files: Mapping[Path, bytes]) -> None:
    """Write temporary files in the same folders, flush them to disk, and rename them once all are written.

    Symbolic links are replaced, not followed. File permissions follow the umask. Raises OSError; then no file has
    changed, unless a rename failed.
    """
    written: dict[Path, Path] = {}
    try:
        for path, content in files.items():
            # unique also among processes of several machines
            temporary = path.with_name(f".{path.name[:100]}.{uuid.uuid4().hex}{TEMPORARY}")
            with temporary.open("xb") as file:
                written[temporary] = path
                file.write(content)
                file.flush()
                os.fsync(file.fileno())  # a full disk may be reported only here
        for temporary, path in written.items():
            os.replace(temporary, path)
    finally:
        for temporary in written:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)
