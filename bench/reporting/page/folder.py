"""A folder of files written in one step: nobody meets half of a site, and no file of an older one stays behind."""

from __future__ import annotations

import os
import shutil
import uuid
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from bench.errors import InputError
from bench.reporting import whole_file

MARKS = ("index.html", "assets", "data")
"""What a site has: no other folder that holds anything is replaced."""


def check_folder(out: Path) -> None:
    """Raise InputError, before any work, for what must not be replaced, or where no folder can be written."""
    if os.path.isfile(out) or (
        os.path.isdir(out) and any(out.iterdir()) and not all((out / name).exists() for name in MARKS)
    ):
        raise InputError("out", out, "a folder that is new, empty, or a site that this command wrote")
    whole_file.check_folder(out)


def write_folder(out: Path, files: Iterable[tuple[str, bytes]]) -> None:
    """Write files by their paths below ``out``, in place of what is there; raises InputError where it cannot."""
    temporary = out.with_name(f".{out.name}.{uuid.uuid4().hex}.tmp")
    old = out.with_name(f".{out.name}.{uuid.uuid4().hex}.old.tmp")
    try:
        for name, content in files:
            path = temporary / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        if out.exists():
            os.replace(out, old)
        os.replace(temporary, out)
    except OSError as error:
        raise InputError("out", out, f"cannot be written ({error.strerror}); name another folder") from None
    finally:
        with suppress(OSError):
            shutil.rmtree(temporary, ignore_errors=True)
            shutil.rmtree(old, ignore_errors=True)
