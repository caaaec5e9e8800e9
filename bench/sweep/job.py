"""Jobs that a launcher runs elsewhere: part of the work of a run, and the file that takes it there.

The file lies in the store, where whoever shares it can write. So it is data under a seal, checked as any other input: a
cell or block that the reader would name otherwise is refused.
"""

from __future__ import annotations

import json
import os
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from bench.engine.pool import Limits, run_tasks, say
from bench.engine.progress import OnLook
from bench.errors import InputError
from bench.files import read_regular, write_whole
from bench.scenario.declaration import STRICT, Positive, validated
from bench.store.archive import Archive
from bench.store.cell import Cell
from bench.store.seal import Unsealed, sealed, unsealed
from bench.store.store import Store
from bench.sweep.plan import Planned, State
from bench.sweep.runner import run_cells

if TYPE_CHECKING:
    from bench.atlas.run import Block

FORMAT = 3


class Job(ABC):
    """Work that a launcher may divide: ``items`` are computed and stored in ``folder``."""

    items: tuple[Any, ...]
    limits: Limits
    unit: ClassVar[str]

    @property
    @abstractmethod
    def folder(self) -> Path:
        """Return the folder of the store, which all nodes see."""

    @abstractmethod
    def left(self) -> list[Any]:
        """Return the items that are still to be computed."""

    @abstractmethod
    def part(self, items: Sequence[Any]) -> Job:
        """Return a job of some of the items."""

    @abstractmethod
    def content(self) -> dict[str, Any]:
        """Return what the job's file holds beside its limits."""

    @abstractmethod
    def run(self, limits: Limits, on_look: OnLook) -> None:
        """Compute and store the items on this machine."""

    def write(self, path: Path) -> None:
        """Write the job's file; raises OSError."""
        limits = {"timeout_s": self.limits.timeout_s, "memory_mb": self.limits.memory_mb}
        write_whole(path, sealed(FORMAT, json.dumps({**limits, self.unit: self.content()})))


@dataclass(frozen=True)
class CellJob(Job):
    """Planned cells. A cell is done once its file is another than the plan has seen."""

    items: tuple[Planned, ...]
    store: Store
    limits: Limits
    unit: ClassVar[str] = "cell"

    @property
    def folder(self) -> Path:
        return self.store.folder

    def left(self) -> list[Planned]:
        there = {entry.name for entry in os.scandir(self.folder)}  # one listing, and a look at known cells only

        def is_left(item: Planned) -> bool:
            identity = item.cell.identity
            return f"{identity}.json" not in there or bool(item.stamp and self.store.stamp(identity) == item.stamp)

        return [item for item in self.items if is_left(item)]

    def part(self, items: Sequence[Planned]) -> CellJob:
        return replace(self, items=tuple(items))

    def content(self) -> dict[str, Any]:
        archive = self.store.archive
        cells = [asdict(WrittenCell.of(item)) for item in self.items]
        return {"archive": str(archive.folder) if archive else None, "cells": cells}

    def run(self, limits: Limits, on_look: OnLook) -> None:
        run_cells(self.items, self.store, limits, on_look)


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
        """Return a planned cell as it is written."""
        cell, force = planned.cell, planned.cell.scenario.force
        file = str(Path(force.file).resolve()) if force and force.file else None
        return cls(cell.identity, planned.state, planned.why, planned.stamp, cell.stated(), file)

    def planned(self) -> Planned:
        """Return the planned cell; raises InputError."""
        file = Path(self.force_file) if self.force_file else None
        return Planned(Cell.restored(self.stated, self.identity, file), self.state, self.why, True, self.stamp)


@dataclass(frozen=True)
class WrittenCells:
    """The content of a file of cells: all but the store, in which the file lies."""

    __pydantic_config__ = STRICT
    archive: str | None
    cells: list[WrittenCell]


@dataclass(frozen=True)
class Atlas:
    """The blocks of a part of the atlas, as the command names them."""

    __pydantic_config__ = STRICT
    test: str
    part: str
    methods: list[str]
    points: int | None

    def blocks(self) -> list[Block]:
        """Return the blocks; raises InputError."""
        from bench.config.atlas import atlas_blocks

        return atlas_blocks(self.part, self.methods, self.points, self.test)


@dataclass(frozen=True)
class WrittenBlocks:
    """The content of a file of blocks: parts of the atlas, and the keys of those blocks that are wanted."""

    __pydantic_config__ = STRICT
    atlas: list[Atlas]
    keys: list[str]


@dataclass(frozen=True)
class BlockJob(Job):
    """Blocks of the atlas."""

    items: tuple[Block, ...]
    atlas: tuple[Atlas, ...]
    store: Path
    limits: Limits
    unit: ClassVar[str] = "block"

    @property
    def folder(self) -> Path:
        return self.store

    def left(self) -> list[Block]:
        return [item for item in self.items if not item.stored(self.store)]

    def part(self, items: Sequence[Block]) -> BlockJob:
        return replace(self, items=tuple(items))

    def content(self) -> dict[str, Any]:
        return asdict(WrittenBlocks(list(self.atlas), [item.key for item in self.items]))

    def run(self, limits: Limits, on_look: OnLook) -> None:
        for key, error in run_tasks(self.items, self.store, limits, ("fit", "block"), on_look).items():
            say(f"block {key}: {error}")


@dataclass(frozen=True)
class Written:
    """The content of a job's file."""

    __pydantic_config__ = STRICT
    timeout_s: Positive
    memory_mb: Positive
    cell: WrittenCells | None = None
    block: WrittenBlocks | None = None


def read_job(path: Path, folder: Path) -> Job:
    """Return the job of a file, for the store in a folder; raises InputError for anything that is none."""
    try:
        written = validated(Written, unsealed(FORMAT, read_regular(path)))
    except OSError as error:
        raise InputError("job", path, f"cannot be read ({error.strerror}); start the sweep again") from None
    except Unsealed as reason:
        raise InputError("job", path, f"not a whole job ({reason}); start the sweep again") from None
    limits = Limits(timeout_s=written.timeout_s, memory_mb=written.memory_mb)
    if written.cell is not None:
        archive = written.cell.archive
        store = Store(folder, Archive(Path(archive)) if archive else None)
        return CellJob(tuple(cell.planned() for cell in written.cell.cells), store, limits)
    if written.block is None:
        raise InputError("job", path, "a job without cells or blocks; start the sweep again")
    known = {block.key: block for atlas in written.block.atlas for block in atlas.blocks()}
    if foreign := set(written.block.keys) - known.keys():
        raise InputError("job", path, f"block {min(foreign)} is not of this atlas; the nodes have another version")
    return BlockJob(tuple(known[key] for key in written.block.keys), tuple(written.block.atlas), folder, limits)
