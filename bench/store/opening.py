"""Which folder is the user's own store, and where the published archive lies, unless something else is said."""

from __future__ import annotations

import os
from pathlib import Path

from bench.errors import InputError
from bench.store.archive import Archive
from bench.store.store import Store

DEFAULT_STORE = "outputs/rows"
"""Under the current folder; a clone ignores it."""
VARIABLE = "VIBRATION_BENCH_ARCHIVE"
NONE = "none"


def default_archive() -> str:
    """The folder named by the environment, or the one of this checkout; ``none`` where there is no such folder."""
    folder = Path(__file__).parents[2] / "results" / "archive"
    return os.environ.get(VARIABLE) or (str(folder) if folder.is_dir() else NONE)


def open_store(folder: str | Path, archive: str | Path | None = None) -> Store:
    """The store in a folder, over the published archive; ``archive`` may name another, or be ``none``.

    Raises InputError where the archive that was asked for is not there.
    """
    chosen = str(archive or default_archive())
    if chosen == NONE:
        return Store(Path(folder))
    if not os.path.isdir(chosen):
        raise InputError("archive", chosen, f"there is no such folder; name another, or {NONE}")
    return Store(Path(folder), Archive(Path(chosen)))
