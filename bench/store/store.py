"""The store: one file per cell, written atomically and named by the identity of the cell.

Every file has a checksum; damaged files are not read. A store contains data only, nothing in it is executed.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Iterator, Set
from pathlib import Path
from statistics import median
from typing import TypeVar

from bench.errors import InputError
from bench.files import TEMPORARY, open_regular, read_regular, write_whole
from bench.store.archive import Archive
from bench.store.cell_file import cell_file, cell_from_file, head_from_line
from bench.store.seal import Unsealed, sealed
from bench.store.stored_cell import CellHead, StoredCell

DEFAULT_STORE = "outputs/rows"
"""Default folder of the user's cells, relative to the current folder."""
VARIABLE, NONE = "VIBRATION_BENCH_ARCHIVE", "none"
"""Environment variable with the folder of the published archive, and the value for no archive."""
BOUND_FORMAT = 1
LONGEST_LINE = 2**24
"""Largest length of a file's first line (bytes); usual descriptions take some thousand."""
ABANDONED_S = 3600.0
"""Age (s) after which a temporary file is assumed to be abandoned."""
Read = TypeVar("Read", StoredCell, CellHead)


class Store:
    """A folder with a file ``<identity>.json`` per cell.

    Cells that are missing in the folder are read from the published ``archive``, if there is one; it is never written.
    """

    def __init__(self, folder: Path, archive: Archive | None = None) -> None:
        self.folder, self.archive = folder, archive

    @property
    def bounds(self) -> Path:
        """The folder of bounds."""
        return self.folder / "bounds"

    @property
    def claims(self) -> Path:
        """The folder of claims (:mod:`bench.store.locks`)."""
        return self.folder / "claims"

    def prepare(self) -> None:
        """Make the folder and check that it can be written; raises InputError if not."""
        probe = self.folder / "write-test"
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            write_whole(probe, b"")
            probe.unlink(missing_ok=True)  # another run may have deleted it
        except OSError as error:
            reason = f"cannot be written ({error.strerror}); use another folder"
            raise InputError("store", self.folder, reason) from None
        for path in self.folder.glob(f".*{TEMPORARY}"):  # temporary files of runs that were killed
            with contextlib.suppress(OSError):
                if time.time() - path.stat().st_mtime > ABANDONED_S:
                    path.unlink()

    def path(self, identity: str) -> Path:
        """Return the path of a cell's file in the folder."""
        return self.folder / f"{identity}.json"

    def stamp(self, identity: str) -> int:
        """Return the time at which a cell's file in the folder was written (ns); 0 if there is none."""
        try:
            return self.path(identity).stat().st_mtime_ns
        except OSError:
            return 0

    def exists(self) -> bool:
        """Return whether the folder or the archive exists."""
        return self.folder.is_dir() or (self.archive is not None and self.archive.folder.is_dir())

    def in_folder(self, identity: str) -> bool:
        """Return whether the folder has a cell."""
        return self.path(identity).exists()

    def __contains__(self, identity: str) -> bool:
        """Return whether the folder or the archive has a cell."""
        return self.in_folder(identity) or (self.archive is not None and identity in self.archive)

    def location(self, identity: str) -> str:
        """Describe where a cell is stored."""
        if self.in_folder(identity) or self.archive is None or identity not in self.archive:
            return f"full result: {self.path(identity)}"
        return f"published archive: {self.archive.path(identity)}"

    def load(self, identity: str) -> StoredCell | None:
        """Return a stored cell, or None; raises InputError if its file is damaged or not a cell."""
        if self.in_folder(identity):
            return self._read(identity, lambda path: cell_from_file(read_regular(path)))
        return self.archive.load(identity) if self.archive is not None else None

    def head(self, identity: str) -> CellHead | None:
        """Return the head of a stored cell, or None; raises InputError as :meth:`load` does."""
        stamp = self.stamp(identity)  # read first, so that a file written meanwhile has a later stamp
        if not stamp:
            return self.archive.head(identity) if self.archive is not None else None

        def first_line(path: Path) -> CellHead:
            with open_regular(path) as file:
                return head_from_line(file.readline(LONGEST_LINE), stamp)

        return self._read(identity, first_line)

    def _read(self, identity: str, read: Callable[[Path], Read]) -> Read:
        path = self.path(identity)
        try:
            cell = read(path)
        except OSError as error:
            raise InputError("store", path, f"cannot be read ({error.strerror}); run again") from None
        except Unsealed as reason:
            remedy = f"damaged or not a cell ({reason}); compute it again with retry=failed, or move the file away"
            raise InputError("store", path, remedy) from None
        if cell.identity != identity:
            raise InputError("store", path, f"contains cell {cell.identity}; move the file away")
        return cell

    def heads(self) -> Iterator[CellHead]:
        """Yield the heads of all stored cells in order; that of a damaged file states the problem."""
        for identity in self.identities():
            try:
                head = self.head(identity)
            except InputError as error:
                head = CellHead(identity, stamp=self.stamp(identity), problem=str(error))
            if head is not None:
                yield head

    def save(self, cell: StoredCell) -> None:
        """Write a cell atomically, replacing any earlier file; raises OSError if that fails."""
        write_whole(self.path(cell.identity), cell_file(cell))

    def damage(self, identity: str) -> str:
        """Return the reason why a cell's file in the folder is damaged; empty if it is intact or missing."""
        try:
            self.load(identity) if self.in_folder(identity) else None
        except InputError as error:
            return str(error)
        return ""

    def fetch_bounds(self, identities: Set[str]) -> None:
        """Copy bounds from the archive to the folder; raises InputError if the folder cannot be written."""
        known = self.archive.bounds() if self.archive is not None else {}
        try:
            for identity in identities & known.keys():
                path = self.bounds / f"{identity}.bound"
                if not path.exists():
                    self.bounds.mkdir(parents=True, exist_ok=True)
                    write_whole(path, sealed(BOUND_FORMAT, known[identity]))
        except OSError as error:
            raise InputError("store", self.bounds, f"cannot be written ({error.strerror}); free disk space") from None

    def identities(self) -> list[str]:
        """Return the identities of all stored cells, sorted."""
        result = set(self.archive.identities()) if self.archive is not None else set()
        if self.folder.is_dir():
            names = (entry.name for entry in os.scandir(self.folder))
            result |= {name.removesuffix(".json") for name in names if name.endswith(".json") and name.isprintable()}
        return sorted(result)

    def __iter__(self) -> Iterator[StoredCell]:
        for identity in self.identities():
            cell = self.load(identity)
            if cell is not None:
                yield cell

    def fit_seconds(self) -> dict[str, float]:
        """Return the median time per fit (s) over the stored cells of each method, by label."""
        seconds: dict[str, list[float]] = {}
        for head in self.heads():
            if not head.problem and head.wall_s > 0:
                seconds.setdefault(head.label, []).append(head.wall_s / head.replicates)
        return {label: median(values) for label, values in sorted(seconds.items())}


def default_archive() -> str:
    """Return the archive named by the environment, or that of this checkout; ``none`` if there is none."""
    folder = Path(__file__).parents[2] / "results" / "archive"
    return os.environ.get(VARIABLE) or (str(folder) if folder.is_dir() else NONE)


def open_store(folder: str | Path, archive: str | Path | None = None) -> Store:
    """Open the store in a folder.

    Args:
        folder: Folder of the store; it need not exist.
        archive: Folder of the published archive, or ``none``; by default :func:`default_archive`.

    Raises:
        InputError: The folder of the archive does not exist.
    """
    chosen = str(archive or default_archive())
    if chosen == NONE:
        return Store(Path(folder))
    if not os.path.isdir(chosen):
        raise InputError("archive", chosen, f"folder not found; name another, or {NONE}")
    return Store(Path(folder), Archive(Path(chosen)))
