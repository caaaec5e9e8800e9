"""The published archive as a reader sees it: cells, their arrays and tracebacks, bounds; never written here."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bench.store.stored import StoredCell

if TYPE_CHECKING:  # pyarrow and what it brings is loaded when a file is read
    import pyarrow as pa

    from bench.store.archive.part import Part


class Archive:
    """A folder of the archive's files. What is not there is an empty archive.

    Every file carries a checksum of itself, and is read only where that agrees. ``older`` files, which had none, are
    read as they are by who says so: to write them anew with one.
    """

    def __init__(self, folder: Path, older: bool = False) -> None:
        self.folder, self._older = folder, older

    def __reduce__(self) -> tuple[object, ...]:
        return Archive, (self.folder, self._older)

    @cached_property
    def parts(self) -> dict[str, Part]:
        """The files with cells, by name; raises InputError for one that is damaged or of another format."""
        from bench.store.archive.bounds import NAME
        from bench.store.archive.part import ENDING, Part

        paths = sorted(self.folder.glob(f"*{ENDING}"))
        return {path.stem: Part(path, self._older) for path in paths if path.name != NAME}

    @cached_property
    def _places(self) -> dict[str, tuple[Part, int]]:
        places = {}
        for part in self.parts.values():
            places.update({identity: (part, line) for line, identity in enumerate(part.identities)})
        return places

    def identities(self) -> list[str]:
        """The names of all cells, in order."""
        return sorted(self._places)

    def __contains__(self, identity: object) -> bool:
        return identity in self._places

    def path(self, identity: str) -> Path:
        """The file that holds a cell."""
        return self._places[identity][0].path

    def load(self, identity: str) -> StoredCell | None:
        """The cell, or None where the archive has none of that name."""
        if identity not in self._places:
            return None
        part, line = self._places[identity]
        return part.cell(line)

    def arrays(self, identity: str) -> dict[str, np.ndarray]:
        """The arrays kept of a cell's replicate; none where the archive has none."""
        if identity not in self._places:
            return {}
        part, line = self._places[identity]
        return part.arrays(line)

    def tracebacks(self, identity: str) -> str:
        """The tracebacks of a cell's failed replicates, or nothing."""
        if identity not in self._places:
            return ""
        part, line = self._places[identity]
        return part.tracebacks(line)

    def tables(self, statistics: Sequence[str] = ()) -> list[pa.Table]:
        """The collected view of the cells (:mod:`bench.store.index`), a table a file: plain columns and some lists."""
        import pyarrow as pa

        from bench.store.archive.decimals import from_codes
        from bench.store.archive.part import DESCRIBED

        found = []
        for part in self.parts.values():
            table = part.table((*DESCRIBED, *(f"all_{name}" for name in statistics))).combine_chunks()
            for name in statistics:
                at = table.column_names.index(f"all_{name}")
                codes = table[at].combine_chunks()
                values = pa.array(from_codes(codes.flatten().to_numpy(zero_copy_only=False)))
                table = table.set_column(at, name, pa.ListArray.from_arrays(codes.offsets, values))
            found.append(table)
        return found

    def bounds(self) -> dict[str, str]:
        """The texts of all bounds by identity; raises InputError where their file is damaged."""
        from bench.store.archive.bounds import read_bounds

        return read_bounds(self.folder, self._older)
