"""Trained networks on disk: one file a layout and settings, trained by one process while others wait for it.

Where a file cannot be written, every process trains the network for itself, which is the same network.
"""

from __future__ import annotations

import hashlib
import json
import os
import zipfile
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
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
    from filelock import FileLock

    digest = hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:24]
    path = folder / f"{digest}.npz"
    with ExitStack() as stack:
        with suppress(OSError, NotImplementedError):
            folder.mkdir(parents=True, exist_ok=True)
            stack.enter_context(FileLock(path.with_suffix(".lock")))
        torn = OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile
        with suppress(*torn), path.open("rb") as file, np.load(file) as stored:
            return {name: stored[name] for name in stored.files}
        arrays, temporary = make(), folder / f"{digest}.{os.getpid()}.tmp"
        with suppress(OSError):
            try:
                with temporary.open("wb") as written:
                    np.savez(written, **arrays)  # type: ignore[arg-type]
                temporary.replace(path)  # so that a reader finds a whole file or none
            finally:
                temporary.unlink(missing_ok=True)
    return arrays
