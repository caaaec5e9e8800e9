"""A file written in one step, so that nobody meets half of one, nor an empty one where the disk is full."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from bench.errors import InputError
from bench.files import write_whole


def write(path: Path, content: str | bytes, given: Path | None = None, field: str = "out") -> None:
    """Write a file in one step.

    Args:
        path: The file.
        content: What is to be in it; a text in UTF-8.
        given: The folder that the user named, where it was no file.
        field: The field in which it was named.

    Raises:
        InputError: Where that cannot be done; it names what the user gave.
    """
    data = content.encode() if isinstance(content, str) else content
    if is_special(path):  # a device or a pipe would be gone, and a file be in its place
        raise InputError(field, given or path, "it is a device or a pipe; name a file")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, data)
    except OSError as error:
        other = "another file" if given is None else "another folder"
        raise InputError(field, given or path, f"cannot be written ({error.strerror}); name {other}") from None


def is_special(path: Path) -> bool:
    """Whether something is there that is neither file nor folder."""
    return os.path.exists(path) and not os.path.isfile(path) and not os.path.isdir(path)


def check_folder(folder: Path, field: str = "out") -> None:
    """Raise InputError before any work where nothing can be written into a folder after it; nothing is left there."""
    _check(folder / ".write-test", folder, field)


def check_file(path: Path, field: str = "out") -> None:
    """The same of a file that is to be written, which must be no folder."""
    if os.path.isdir(path):
        raise InputError(field, path, "it is a folder; name a file")
    if is_special(path):
        raise InputError(field, path, "it is a device or a pipe; name a file")
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
