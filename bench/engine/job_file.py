"""Jobs of a launcher: a file in the store that describes cells, or blocks of the atlas, to be computed elsewhere.

Everybody who shares the store can write the file. It therefore contains data only, with a checksum, and is validated
like any other input: a cell or block whose identity does not match its description is rejected.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

from bench.atlas.run import PointBlock
from bench.engine.plan import CellState, Planned
from bench.engine.pool import Limits, print_line, run_tasks
from bench.engine.progress import OnProgress
from bench.engine.runner import run_cells
from bench.errors import InputError
from bench.files import read_regular, write_whole
from bench.scenario.declaration import STRICT, Positive, validated
from bench.store.archive import Archive
from bench.store.cell import Cell
from bench.store.seal import Unsealed, sealed, unsealed
from bench.store.store import Store

FORMAT = 4
LaunchTask = Planned | PointBlock


@dataclass(frozen=True)
class TaskFile:
    """Description of a cell or block in a job's file; for a cell also its state in the store and its force's file."""

    __pydantic_config__ = STRICT
    kind: Literal["cell", "block"]
    key: str
    content: dict[str, Any]
    state: CellState = CellState.MISSING
    stamp: int = 0
    force_file: str | None = None

    @classmethod
    def of(cls, task: LaunchTask) -> TaskFile:
        """Return the description of a task."""
        if isinstance(task, PointBlock):
            return cls("block", task.key, task.description())
        force = task.cell.scenario.force
        file = str(Path(force.file).resolve()) if force and force.file else None
        return cls("cell", task.key, task.cell.full_description(), task.state, task.stamp, file)

    def task(self) -> LaunchTask:
        """Return the task; raises InputError if its identity does not match."""
        if self.kind == "block":
            return PointBlock.from_description(self.content, self.key)
        cell = Cell.from_description(self.content, self.key, Path(self.force_file) if self.force_file else None)
        return Planned(cell, self.state, "", True, self.stamp)


@dataclass(frozen=True)
class Content:
    """Content of a job's file."""

    __pydantic_config__ = STRICT
    timeout_s: Positive
    memory_mb: Positive
    archive: str | None
    tasks: list[TaskFile]


@dataclass(frozen=True)
class LaunchJob:
    """Cells, or blocks of the atlas, to be computed and stored in a store that all nodes share."""

    tasks: tuple[LaunchTask, ...]
    store: Store
    limits: Limits

    @property
    def unit(self) -> str:
        """The name of a task in the progress display."""
        return "cell" if isinstance(self.tasks[0], Planned) else "block"

    def left(self) -> list[LaunchTask]:
        """Return the tasks that are not stored yet."""
        return [task for task in self.tasks if not task.stored(self.store.folder)]

    def part(self, tasks: Sequence[LaunchTask]) -> LaunchJob:
        """Return a job with some of the tasks."""
        return replace(self, tasks=tuple(tasks))

    def run(self, limits: Limits, on_progress: OnProgress) -> None:
        """Compute and store the tasks on this machine."""
        run_cells([task for task in self.tasks if isinstance(task, Planned)], self.store, limits, on_progress)
        blocks = [task for task in self.tasks if isinstance(task, PointBlock)]
        for key, error in run_tasks(blocks, self.store.folder, limits, ("fit", "block"), on_progress).items():
            print_line(f"block {key}: {error}")

    def write(self, path: Path) -> None:
        """Write the job's file; raises OSError."""
        archive = str(self.store.archive.folder.resolve()) if self.store.archive else None
        tasks = [TaskFile.of(task) for task in self.tasks]
        content = Content(self.limits.timeout_s, self.limits.memory_mb, archive, tasks)
        write_whole(path, sealed(FORMAT, json.dumps(asdict(content))))


def read_job(path: Path, folder: Path) -> LaunchJob:
    """Read a job from a file, for the store in a folder; raises InputError for an invalid file."""
    try:
        content = validated(Content, unsealed(FORMAT, read_regular(path)))
    except OSError as error:
        raise InputError("job", path, f"cannot be read ({error.strerror}); start the sweep again") from None
    except Unsealed as reason:
        raise InputError("job", path, f"not a complete job ({reason}); start the sweep again") from None
    store = Store(folder, Archive(Path(content.archive)) if content.archive else None)
    limits = Limits(timeout_s=content.timeout_s, memory_mb=content.memory_mb)
    return LaunchJob(tuple(task.task() for task in content.tasks), store, limits)
