"""Cache of trained networks: one file per layout and settings, trained by one process while others wait.

Where a file cannot be written, every process trains the same network itself.
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
    """Return the given folder, or the default one in the user's cache."""
    if stated:
        return Path(stated)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "vibration-bench" / "npe"


def cached(folder: Path, identity: Mapping[str, object], make: Callable[[], Arrays]) -> Arrays:
    """Return the cached arrays of an identity; where there are none, call ``make`` and store its result."""
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
                temporary.replace(path)  # atomic, so that readers never see a partial file
            finally:
                temporary.unlink(missing_ok=True)
    return arrays
