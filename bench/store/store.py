"""The store: one JSON file a cell, written whole or not at all, named by the hash of the question it answers.

Beside it lie, written first, the arrays of one of its replicates (``.npz``) and the tracebacks of those that failed
(``.errors.txt``). The cell's file carries a checksum of its own content and of that of the files beside it; what does
not agree with it is damaged, and never read. Nothing in a store is executed: it is text, numbers and names.
"""

from __future__ import annotations

import contextlib
import os
import time
import uuid
from collections.abc import Callable, Iterator, Mapping, Set
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from bench.errors import InputError
from bench.store.bound_file import bound_file
from bench.store.cell_file import (
    ARRAYS,
    ERRORS,
    FORMAT,
    arrays_file,
    beside_name,
    cell_file,
    cell_from_file,
    check_beside,
    head_from_line,
    read_arrays,
)
from bench.store.seal import OtherFormat, Unsealed, read_first_line, read_regular, write_new
from bench.store.stored import Head, StoredCell

if TYPE_CHECKING:
    from bench.store.archive import Archive

AGAIN = "retry=failed computes it again, or move it away"
Found = TypeVar("Found", StoredCell, Head)
ABANDONED_S = 3600.0
"""Age at which a temporary file has no writer any more."""


class Unreadable(InputError):
    """A file that may well be whole, but could not be read just now: nothing is concluded from that."""


class Store:
    """A folder with one ``<identity>.json`` a cell; bounds lie in a folder beside them, under another ending.

    What the folder lacks is looked up in the published ``archive``, if there is one, which is never written.
    """

    def __init__(self, folder: Path, archive: Archive | None = None) -> None:
        self.folder, self.archive = folder, archive

    @property
    def bounds(self) -> Path:
        return self.folder / "bounds"

    @property
    def claims(self) -> Path:
        """Folder of the claims of runs under way (:mod:`bench.store.locks`)."""
        return self.folder / "claims"

    def prepare(self) -> None:
        """Make the folder and check that it can be written; raises InputError before anything runs."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            probe = self.folder / f"write-test.{uuid.uuid4().hex}.tmp"
            write_new(probe, b"")
            probe.unlink()
        except OSError as error:
            reason = f"cannot be written ({error.strerror}); name another folder"
            raise InputError("store", self.folder, reason) from None
        for left in self.folder.glob("*.tmp"):  # of writers that were killed
            with contextlib.suppress(OSError):
                if time.time() - left.stat().st_mtime > ABANDONED_S:
                    left.unlink()

    def path(self, identity: str) -> Path:
        return self.folder / f"{identity}.json"

    def stamp(self, identity: str) -> int:
        """When a stored cell was written (ns); 0 where there is none."""
        try:
            return self.path(identity).stat().st_mtime_ns
        except OSError:
            return 0

    def there(self) -> bool:
        """Whether there is anything to read from, be it empty."""
        return self.folder.is_dir() or (self.archive is not None and self.archive.folder.is_dir())

    def own(self, identity: str) -> bool:
        """Whether the folder itself holds a cell."""
        return self.path(identity).exists()

    def holds(self, identity: str) -> bool:
        """Whether the folder or the archive holds a cell."""
        return self.own(identity) or (self.archive is not None and identity in self.archive)

    def whereabouts(self, identity: str) -> str:
        """Where a cell lies, in words."""
        if self.own(identity) or self.archive is None or identity not in self.archive:
            return f"full result: {self.path(identity)}"
        return f"published archive: {self.archive.path(identity)}"

    def load(self, identity: str) -> StoredCell | None:
        """Return a stored cell, or None; a damaged or foreign file raises InputError and is left alone."""
        if self.own(identity):
            return self._read(self.path(identity))
        return self.archive.load(identity) if self.archive is not None else None

    def head(self, identity: str) -> Head | None:
        """Return what is known of a stored cell without its rows, or None; raises InputError as :meth:`load`."""
        stamp = self.stamp(identity)  # before the look: what is written after it is newer
        if stamp:
            return self._checked(self.path(identity), lambda path: head_from_line(read_first_line(path), stamp))
        return self.archive.head(identity) if self.archive is not None else None

    def heads(self) -> Iterator[Head]:
        """Yield the heads of all stored cells in order; of a damaged file one that states its problem."""
        for identity in self.identities():
            try:
                head = self.head(identity)
            except InputError as error:
                head = Head(identity, stamp=self.stamp(identity), problem=str(error))
            if head is not None:
                yield head

    def save(
        self, cell: StoredCell, arrays: Mapping[str, np.ndarray] | None = None, tracebacks: str = ""
    ) -> StoredCell:
        """Write a cell whole, in the place of any before it: what it refers to first, itself last, in one step.

        Returns the cell with the names of its files. Raises OSError where there is no room; what was there then stays.
        """
        contents = {ARRAYS: arrays_file(arrays) if arrays else b"", ERRORS: tracebacks.encode("utf-8", "replace")}
        names = {ending: beside_name(cell.identity, content, ending) for ending, content in contents.items()}
        for ending, name in names.items():
            if name:  # where such a file is there, too: it may be damaged
                self._write(self.folder / name, contents[ending])
        before = self._beside_before(cell.identity)
        stored = replace(cell, arrays=names[ARRAYS], errors=names[ERRORS])
        self._write(self.path(cell.identity), cell_file(stored))
        for name in before - set(names.values()):
            (self.folder / name).unlink(missing_ok=True)
        return stored

    def _beside_before(self, identity: str) -> set[str]:
        """Return the names of the files that a cell has beside it, as far as they are known."""
        with contextlib.suppress(InputError):
            if self.own(identity):
                cell = self._read(self.path(identity))
                return {name for name in (cell.arrays, cell.errors) if name}
        return set()

    def errors(self, cell: StoredCell) -> Path | None:
        """Return the file of the tracebacks of a cell's failed replicates, if there is one."""
        return self.folder / cell.errors if cell.errors and self.own(cell.identity) else None

    def tracebacks(self, cell: StoredCell) -> str:
        """Return the tracebacks of a cell's failed replicates, or nothing.

        Raises InputError where they are missing, or not the ones that the cell was stored with.
        """
        if self.archive is not None and not self.own(cell.identity):
            return self.archive.tracebacks(cell.identity)
        if not cell.errors:
            return ""
        content = self._beside(cell.errors, "tracebacks")
        return content.decode(errors="replace")

    def arrays(self, cell: StoredCell) -> dict[str, np.ndarray]:
        """Return the arrays kept of one replicate; none where the cell has none.

        Raises InputError where they are missing, or not the ones that the cell was stored with.
        """
        if not cell.arrays:
            return {}
        if self.archive is not None and not self.own(cell.identity):
            return self.archive.arrays(cell.identity)
        content = self._beside(cell.arrays, "arrays")
        try:
            return read_arrays(cell.arrays, content)
        except Unsealed as reason:
            raise InputError(
                "store", self.folder / cell.arrays, f"not the arrays of its cell ({reason}); {AGAIN}"
            ) from None

    def _beside(self, name: str, what: str) -> bytes:
        """Return the bytes of a file beside a cell's; raises InputError where its name does not state them."""
        path = self.folder / name
        try:
            content = read_regular(path)
            check_beside(name, content)
        except OSError as error:
            raise InputError("store", path, f"cannot be read ({error.strerror}); {AGAIN}") from None
        except Unsealed as reason:
            raise InputError("store", path, f"not the {what} of its cell ({reason}); {AGAIN}") from None
        return content

    def damage(self, identity: str) -> str:
        """Say why the folder's own files of a cell are not whole; nothing where they are, or none is there."""
        try:
            if self.own(identity):
                cell = self._read(self.path(identity))
                self.arrays(cell)
                self.tracebacks(cell)
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
                    self._write(path, bound_file(known[identity]))
        except OSError as error:
            raise InputError("store", self.bounds, f"cannot be written ({error.strerror}); make room") from None

    def _write(self, path: Path, content: bytes) -> None:
        """To a temporary file, flushed to disk, then renamed."""
        temporary = path.with_name(f"{path.name}.{uuid.uuid4().hex}.tmp")  # two machines can have the same process ids
        try:
            write_new(temporary, content)
            os.replace(temporary, path)
        except OSError:
            with contextlib.suppress(OSError):
                temporary.unlink()
            raise

    def identities(self) -> list[str]:
        """The names of all stored cells, in order."""
        found = set(self.archive.identities()) if self.archive is not None else set()
        if self.folder.is_dir():
            found |= {name for entry in os.scandir(self.folder) if (name := named_by(entry))}
        return sorted(found)

    def __iter__(self) -> Iterator[StoredCell]:
        for identity in self.identities():
            cell = self.load(identity)
            if cell is not None:
                yield cell

    def _read(self, path: Path) -> StoredCell:
        return self._checked(path, lambda path: cell_from_file(read_regular(path)))

    def _checked(self, path: Path, read: Callable[[Path], Found]) -> Found:
        try:
            cell = read(path)
        except OSError as error:
            raise Unreadable("store", path, f"it cannot be read now ({error.strerror}); run again") from None
        except OtherFormat as other:
            remedy = f"a cell of format {other.found}, this version reads {FORMAT}; move it away"
            raise InputError("store", path, remedy) from None
        except Unsealed as reason:
            raise InputError("store", path, f"not a whole cell of this benchmark ({reason}); {AGAIN}") from None
        if cell.identity != path.stem:
            raise InputError("store", path, f"it holds the cell {cell.identity}; move it away")
        return cell


def named_by(entry: os.DirEntry[str]) -> str:
    """Return the identity of the cell whose file this is; nothing for other files, or a name that cannot be printed."""
    name = entry.name.removesuffix(".json")
    return name if name != entry.name and name.isprintable() else ""
