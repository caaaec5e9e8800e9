"""Write files in one step, so that no incomplete file is left if writing fails."""

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
        content: Bytes, or a text to be encoded in UTF-8.
        given: Folder that the user named, for errors; None for the file itself.
        field: Field that named it, for errors.

    Raises:
        InputError: If the file cannot be written.
    """
    if is_special(path):  # writing would replace a device or a pipe by a file
        raise InputError(field, given or path, "it is a device or a pipe; name a file")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, content.encode() if isinstance(content, str) else content)
    except OSError as error:
        other = "another file" if given is None else "another folder"
        raise InputError(field, given or path, f"cannot be written ({error.strerror}); name {other}") from None


def is_special(path: Path) -> bool:
    """Return whether a path exists that is neither file nor folder."""
    return os.path.exists(path) and not os.path.isfile(path) and not os.path.isdir(path)


def check_folder(folder: Path, field: str = "out") -> None:
    """Raise InputError, before any computation, if no file can be written into a folder; leaves nothing behind."""
    _check(folder / ".write-test", folder, field)


def check_file(path: Path, field: str = "out") -> None:
    """Raise InputError, before any computation, if a file cannot be written; leaves nothing behind."""
    if os.path.isdir(path) or is_special(path):
        what = "a folder" if os.path.isdir(path) else "a device or a pipe"
        raise InputError(field, path, f"it is {what}; name a file")
    _check(path.with_name(f".{path.name}.write-test"), path, field)


def _check(probe: Path, given: Path, field: str) -> None:
    """Write a file, and remove it again with the folders that were created for it."""
    new = [folder for folder in probe.parents if not os.path.lexists(folder)]
    try:
        write(probe, "", given, field)
    finally:
        with suppress(OSError):
            probe.unlink(missing_ok=True)
            for folder in new:
                folder.rmdir()
