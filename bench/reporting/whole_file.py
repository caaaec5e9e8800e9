"""A file written in one step, so that nobody meets half of one, nor an empty one where the disk is full."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from bench.errors import InputError
from bench.files import write_whole


def write(path: Path, content: str | bytes, given: Path | None = None, field: str = "out") -> None:
    """Write a file in one step; a text in UTF-8.

    Raises InputError where that cannot be done, which names the ``field`` and the folder that the user had ``given``
    in it, or the file.
    """
    if is_special(path):  # a device or a pipe would be gone, and a file be in its place
        raise InputError(field, given or path, "it is a device or a pipe; name a file")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, content.encode() if isinstance(content, str) else content)
    except OSError as error:
        other = "another file" if given is None else "another folder"
        raise InputError(field, given or path, f"cannot be written ({error.strerror}); name {other}") from None


def is_special(path: Path) -> bool:
    """Return whether something is there that is neither file nor folder."""
    return os.path.exists(path) and not os.path.isfile(path) and not os.path.isdir(path)


def check_folder(folder: Path, field: str = "out") -> None:
    """Raise InputError before any work where nothing can be written into a folder after it; nothing is left there."""
    _check(folder / ".write-test", folder, field)


def check_file(path: Path, field: str = "out") -> None:
    """Raise InputError before any work where a file cannot be written after it; nothing is left there."""
    if os.path.isdir(path) or is_special(path):
        what = "a folder" if os.path.isdir(path) else "a device or a pipe"
        raise InputError(field, path, f"it is {what}; name a file")
    _check(path.with_name(f".{path.name}.write-test"), path, field)


def _check(probe: Path, given: Path, field: str) -> None:
    """Write a file and take it away again, and with it the folders that it needed."""
    new = [folder for folder in probe.parents if not os.path.lexists(folder)]
    try:
        write(probe, "", given, field)
    finally:
        with suppress(OSError):
            probe.unlink(missing_ok=True)
            for folder in new:
                folder.rmdir()
