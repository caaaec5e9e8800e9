"""Files as all rooms read and write them: regular files only, written whole or not at all."""

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
"""Ending of files that are being written; what a killed writer leaves has it."""


def open_regular(path: Path) -> BinaryIO:
    """Open a file for reading; raises OSError, also for a device or a pipe, which could be read without end."""
    handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise OSError(errno.EINVAL, "it is no regular file", str(path))
    return os.fdopen(handle, "rb")


def read_regular(path: Path) -> bytes:
    """Read a file; raises OSError as :func:`open_regular`."""
    with open_regular(path) as file:
        return file.read()


def write_whole(path: Path, content: bytes) -> None:
    """Write a file whole or not at all, see :func:`write_together`."""
    write_together({path: content})


def write_together(files: Mapping[Path, bytes]) -> None:
    """Write files beside their places, flush them to disk, and rename them once all are written.

    Never through a symbolic link that somebody has left under a name. Their rights are what the umask leaves. Raises
    OSError, and has then changed nothing, unless a rename failed.
    """
    written: dict[Path, Path] = {}
    try:
        for path, content in files.items():
            # two machines can have the same process ids
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
