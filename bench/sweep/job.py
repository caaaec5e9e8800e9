"""A job of a sweep that a launcher runs elsewhere: some of its cells, and the file that takes them there.

The file lies in the store, where whoever shares it can write. So it is data: the description of each cell as a store
has it, under a seal, and checked as any other input. A cell that the reader would name otherwise is refused.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from bench.errors import InputError
from bench.scenario.declaration import STRICT, Positive, validated
from bench.store.archive.archive import Archive
from bench.store.cell import Cell
from bench.store.seal import Unsealed, read_regular, sealed, unsealed, write_new
from bench.store.store import Store
from bench.sweep.plan import Planned, State
from bench.sweep.workers import Limits

FORMAT = 2


@dataclass(frozen=True)
class Job:
    """What a job is given. A cell is done once its file is another than the plan has seen."""

    planned: tuple[Planned, ...]
    store: Store
    limits: Limits

    def part(self, planned: Sequence[Planned]) -> Job:
        """A job of some of the cells."""
        return replace(self, planned=tuple(planned))

    def left(self) -> list[Planned]:
        """Those that are still to be computed."""
        return [one for one in self.planned if self.store.stamp(one.cell.identity) == one.stamp]


@dataclass(frozen=True)
class WrittenCell:
    """A planned cell as a job's file has it; ``force_file``: where its force is, if that was read from a file."""

    __pydantic_config__ = STRICT
    identity: str
    state: State
    why: str
    stamp: int
    stated: dict[str, Any]
    force_file: str | None

    @classmethod
    def of(cls, planned: Planned) -> WrittenCell:
        """A planned cell, to be written."""
        cell, force = planned.cell, planned.cell.scenario.force
        file = str(Path(force.file).resolve()) if force and force.file else None
        return cls(cell.identity, planned.state, planned.why, planned.stamp, cell.stated(), file)

    def planned(self) -> Planned:
        """A planned cell that was read; raises InputError."""
        file = Path(self.force_file) if self.force_file else None
        return Planned(Cell.restored(self.stated, self.identity, file), self.state, self.why, True, self.stamp)


@dataclass(frozen=True)
class Written:
    """A job as its file has it: all but the store, in which the file lies, and what a node says of itself."""

    __pydantic_config__ = STRICT
    cells: list[WrittenCell]
    archive: str | None
    timeout_s: Positive
    memory_mb: Positive


def write_job(path: Path, job: Job) -> None:
    """Write a job's file; raises OSError."""
    archive, limits = job.store.archive, job.limits
    folder = str(archive.folder) if archive else None
    cells = [WrittenCell.of(one) for one in job.planned]
    content = Written(cells, folder, limits.timeout_s, limits.memory_mb)
    write_new(path, sealed(FORMAT, json.dumps(asdict(content))))


def read_job(path: Path, folder: Path) -> Job:
    """The job of a file, for the store in a folder; raises InputError for anything that is none."""
    try:
        found = validated(Written, unsealed(FORMAT, read_regular(path)))
    except OSError as error:
        raise InputError("job", path, f"cannot be read ({error.strerror}); start the sweep again") from None
    except Unsealed as reason:
        raise InputError("job", path, f"not a whole job ({reason}); start the sweep again") from None
    planned = tuple(one.planned() for one in found.cells)
    store = Store(folder, Archive(Path(found.archive)) if found.archive else None)
    return Job(planned, store, Limits(timeout_s=found.timeout_s, memory_mb=found.memory_mb))
