"""The store: one file a cell, written whole or not at all, named by the hash of the question it answers.

A file carries a checksum of its content; what does not agree with it is damaged, and never read. Nothing in a store is
executed: it is text, numbers and names.
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
from bench.store.stored import CellHead, StoredCell

DEFAULT_STORE = "outputs/rows"
"""The folder of a user's own cells, under the current folder."""
VARIABLE, NONE = "VIBRATION_BENCH_ARCHIVE", "none"
"""The environment's name of the published archive's folder, and the value that stands for no archive."""
BOUND_FORMAT = 1
LONGEST_LINE = 2**24
"""Bytes of a file's first line; a description takes some thousand."""
ABANDONED_S = 3600.0
"""Age at which a temporary file has no writer any more."""
Read = TypeVar("Read", StoredCell, CellHead)


class Store:
    """A folder with one ``<identity>.json`` a cell; bounds lie in a folder beside them, under another ending.

    What the folder lacks is looked up in the published ``archive``, if there is one, which is never written.
    """

    def __init__(self, folder: Path, archive: Archive | None = None) -> None:
        self.folder, self.archive = folder, archive

    @property
    def bounds(self) -> Path:
        """The folder of bounds."""
        return self.folder / "bounds"

    @property
    def claims(self) -> Path:
        """Folder of the claims of runs under way (:mod:`bench.store.locks`)."""
        return self.folder / "claims"

    def prepare(self) -> None:
        """Make the folder and check that it can be written; raises InputError before anything runs."""
        probe = self.folder / "write-test"
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            write_whole(probe, b"")
            probe.unlink(missing_ok=True)  # another run may have done so
        except OSError as error:
            reason = f"cannot be written ({error.strerror}); name another folder"
            raise InputError("store", self.folder, reason) from None
        for left in self.folder.glob(f".*{TEMPORARY}"):  # of writers that were killed
            with contextlib.suppress(OSError):
                if time.time() - left.stat().st_mtime > ABANDONED_S:
                    left.unlink()

    def path(self, identity: str) -> Path:
        """Return the file of a cell of the folder."""
        return self.folder / f"{identity}.json"

    def stamp(self, identity: str) -> int:
        """Return when a cell of the folder was written (ns); 0 where there is none."""
        try:
            return self.path(identity).stat().st_mtime_ns
        except OSError:
            return 0

    def there(self) -> bool:
        """Return whether there is anything to read from, be it empty."""
        return self.folder.is_dir() or (self.archive is not None and self.archive.folder.is_dir())

    def own(self, identity: str) -> bool:
        """Return whether the folder itself holds a cell."""
        return self.path(identity).exists()

    def holds(self, identity: str) -> bool:
        """Return whether the folder or the archive holds a cell."""
        return self.own(identity) or (self.archive is not None and identity in self.archive)

    def whereabouts(self, identity: str) -> str:
        """Say in words where a cell lies."""
        if self.own(identity) or self.archive is None or identity not in self.archive:
            return f"full result: {self.path(identity)}"
        return f"published archive: {self.archive.path(identity)}"

    def load(self, identity: str) -> StoredCell | None:
        """Return a stored cell, or None; a damaged or foreign file raises InputError and is left alone."""
        if self.own(identity):
            return self._read(identity, lambda path: cell_from_file(read_regular(path)))
        return self.archive.load(identity) if self.archive is not None else None

    def head(self, identity: str) -> CellHead | None:
        """Return what is known of a stored cell without its rows, or None; raises InputError as :meth:`load`."""
        stamp = self.stamp(identity)  # before the look: what is written after it is newer
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
            raise InputError("store", path, f"it cannot be read now ({error.strerror}); run again") from None
        except Unsealed as reason:
            remedy = f"not a whole cell of this benchmark ({reason}); retry=failed computes it again, or move it away"
            raise InputError("store", path, remedy) from None
        if cell.identity != identity:
            raise InputError("store", path, f"it holds the cell {cell.identity}; move it away")
        return cell

    def heads(self) -> Iterator[CellHead]:
        """Yield the heads of all stored cells in order; of a damaged file one that states its problem."""
        for identity in self.identities():
            try:
                head = self.head(identity)
            except InputError as error:
                head = CellHead(identity, stamp=self.stamp(identity), problem=str(error))
            if head is not None:
                yield head

    def save(self, cell: StoredCell) -> None:
        """Write a cell whole, in the place of any before it; raises OSError without room, and keeps what was there."""
        write_whole(self.path(cell.identity), cell_file(cell))

    def damage(self, identity: str) -> str:
        """Say why the folder's own file of a cell is not whole; nothing where it is, or none is there."""
        try:
            self.load(identity) if self.own(identity) else None
        except InputError as error:
            return str(error)
        return ""

    def fetch_bounds(self, identities: Set[str]) -> None:
        """Write the bounds that the archive has and the folder lacks beside the cells; raises InputError."""
        known = self.archive.bounds() if self.archive is not None else {}
        try:
            for identity in identities & known.keys():
                path = self.bounds / f"{identity}.bound"
                if not path.exists():
                    self.bounds.mkdir(parents=True, exist_ok=True)
                    write_whole(path, sealed(BOUND_FORMAT, known[identity]))
        except OSError as error:
            raise InputError("store", self.bounds, f"cannot be written ({error.strerror}); make room") from None

    def identities(self) -> list[str]:
        """Return the names of all stored cells, in order."""
        found = set(self.archive.identities()) if self.archive is not None else set()
        if self.folder.is_dir():
            names = (entry.name for entry in os.scandir(self.folder))
            found |= {name.removesuffix(".json") for name in names if name.endswith(".json") and name.isprintable()}
        return sorted(found)

    def __iter__(self) -> Iterator[StoredCell]:
        for identity in self.identities():
            cell = self.load(identity)
            if cell is not None:
                yield cell

    def fit_seconds(self) -> dict[str, float]:
        """Return the median wall-clock time of a fit (s) over the stored cells of each method, by label."""
        seconds: dict[str, list[float]] = {}
        for head in self.heads():
            if not head.problem and head.wall_s > 0:
                seconds.setdefault(head.label, []).append(head.wall_s / head.replicates)
        return {label: median(values) for label, values in sorted(seconds.items())}


def default_archive() -> str:
    """Return the folder named by the environment, or the one of this checkout; ``none`` where there is none."""
    folder = Path(__file__).parents[2] / "results" / "archive"
    return os.environ.get(VARIABLE) or (str(folder) if folder.is_dir() else NONE)


def open_store(folder: str | Path, archive: str | Path | None = None) -> Store:
    """Open the store in a folder, over the published archive; ``archive`` may name another, or be ``none``.

    Raises InputError where the archive that was asked for is not there.
    """
    chosen = str(archive or default_archive())
    if chosen == NONE:
        return Store(Path(folder))
    if not os.path.isdir(chosen):
        raise InputError("archive", chosen, f"there is no such folder; name another, or {NONE}")
    return Store(Path(folder), Archive(Path(chosen)))
