"""``SHA256SUMS``: the one list of checksums of a folder, which ``sha256sum -c`` reads, too."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from pathlib import Path

from bench.errors import InputError
from bench.store.seal import read_regular

NAME = "SHA256SUMS"
LINE = re.compile(r"([0-9a-f]{64})  ([a-z0-9_./]+)")
REMEDY = "not a whole file of the archive; fetch it again"


def read_sums(folder: Path) -> dict[str, str]:
    """Return the checksums by file; none where the folder has no list. Raises InputError for a damaged list."""
    path = folder / NAME
    if not path.exists():
        return {}
    text = _read(path).decode(errors="replace")
    lines = [LINE.fullmatch(line) for line in text.split("\n")[:-1]]
    if not lines or not text.endswith("\n") or not all(lines):
        raise InputError("archive", path, REMEDY)
    return {line[2]: line[1] for line in lines if line}


def sums_text(sums: Mapping[str, str]) -> str:
    """Return the text of a list."""
    return "".join(f"{digest}  {name}\n" for name, digest in sorted(sums.items()))


def checked(folder: Path, name: str, sums: Mapping[str, str]) -> bytes:
    """Return the bytes of a file; raises InputError where they do not agree with the list."""
    content = _read(folder / name)
    if hashlib.sha256(content).hexdigest() != sums.get(name):
        raise InputError("archive", folder / name, f"{REMEDY} (its checksum is not that of {NAME})")
    return content


def _read(path: Path) -> bytes:
    try:
        return read_regular(path)
    except OSError as error:
        raise InputError("archive", path, f"{REMEDY} ({error.strerror})") from None
