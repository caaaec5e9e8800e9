"""Trained networks on disk: one file a layout and settings, trained by one process while others wait for it.

A file is written beside its place and moved there, so that a reader finds a whole one or none. The lock is the
operating system's: it ends with the process that holds it. Where a file cannot be written, every process trains its
own, which is the same network.
"""

from __future__ import annotations

import hashlib
import json
import os
import uuid
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

Arrays = dict[str, np.ndarray]


def cache_folder(stated: str) -> Path:
    """The folder that is stated, else one of the user's caches."""
    if stated:
        return Path(stated)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "vibration-bench" / "npe"


def cached(folder: Path, identity: Mapping[str, object], make: Callable[[], Arrays]) -> Arrays:
    """The arrays of an identity: those of the file, else what ``make`` returns, which is then kept."""
    digest = hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:24]
    path = folder / f"{digest}.npz"
    found = _read(path)
    if found is not None:
        return found
    with _alone(path.with_suffix(".lock")):
        found = _read(path)
        if found is None:
            found = make()
            _write(path, found)
    return found


def _read(path: Path) -> Arrays | None:
    """The arrays of a file; None where there is none, or one that cannot be read."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
        return None


def _write(path: Path, arrays: Arrays) -> None:
    beside = path.with_name(f"{path.stem}.{uuid.uuid4().hex}.tmp")
    with suppress(OSError):
        try:
            with beside.open("wb") as file:
                np.savez(file, **arrays)  # type: ignore[arg-type]
                file.flush()
                os.fsync(file.fileno())
            beside.replace(path)
        finally:
            beside.unlink(missing_ok=True)


@contextmanager
def _alone(path: Path) -> Iterator[None]:
    """Hold a lock among the processes of this machine; nothing is held where the system has none to give."""
    try:
        import fcntl

        path.parent.mkdir(parents=True, exist_ok=True)
        file = path.open("w")
    except (ImportError, OSError):
        yield
        return
    with file:
        with suppress(OSError):
            fcntl.flock(file, fcntl.LOCK_EX)
        yield
