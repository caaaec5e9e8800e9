"""A file written in one step, so that nobody meets half of one."""

from __future__ import annotations

import os
import uuid
from contextlib import suppress
from pathlib import Path

from bench.errors import InputError


def write(path: Path, text: str, given: Path | None = None) -> None:
    """Write a text in one step.

    Args:
        path: The file.
        text: What is to be in it.
        given: The folder that the user named with ``out=``, where it was no file.

    Raises:
        InputError: Where that cannot be done; it names what the user gave.
    """
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_text(text, encoding="utf-8", newline="\n")
        os.replace(temporary, path)
    except OSError as error:
        with suppress(OSError):  # nor can it be taken away where it could not be made
            temporary.unlink(missing_ok=True)
        other = "another file" if given is None else "another folder"
        raise InputError("out", given or path, f"cannot be written ({error.strerror}); name {other}") from None
