"""The work of experiments that are not made of cells: the atlas and the online, measured and modal tracks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Protocol

from bench.commands.log import LOG
from bench.config.fields import MOST_WORKERS
from bench.engine.pool import Limits, StoredTask, print_line, run_tasks
from bench.engine.progress import progress_bar
from bench.reporting.whole_file import check_folder, write
from bench.scenario.declaration import Within
from bench.store.table_versions import FILE, with_table

Workers = Annotated[int | None, Within(ge=1, le=MOST_WORKERS), "worker processes [one per core]"]
Fit = Annotated[bool, "false: compute nothing, write the stored results"]
DryRun = Annotated[bool, "only count the tasks to do"]


class VersionedTask(StoredTask, Protocol):
    """A task that names the registered classes that it uses."""

    @property
    def used(self) -> set[tuple[str, str]]:
        """Groups and names of entry points."""


@dataclass(frozen=True)
class Work:
    """The folders and limits of an experiment.

    Attributes:
        store: Folder of finished tasks.
        out: Folder of tables.
        limits: Workers, time and memory.
        fit: Whether missing tasks are computed.
        dry_run: Whether tasks are only counted.
        launcher: Overrides of a launcher of Hydra's, for blocks of the atlas.
    """

    store: Path
    out: Path
    limits: Limits
    fit: bool = True
    dry_run: bool = False
    launcher: tuple[str, ...] = ()

    def complete(self, tasks: Sequence[StoredTask], unit: str) -> bool:
        """Compute the tasks that the store lacks; return whether tables are to be written. Raises InputError."""
        if not self.dry_run:
            check_folder(self.store, "store")
            check_folder(self.out)
        missing = [task for task in tasks if not task.stored(self.store)]
        LOG.info("%s", f"{sum(task.size for task in tasks):,} {unit}s, {len(missing):,} tasks to do")
        if self.dry_run:
            return False
        if missing and self.fit and self.launcher:
            from bench.engine.job_file import LaunchJob
            from bench.engine.launch import Launch, launch_job
            from bench.store.store import Store

            launch_job(LaunchJob(tuple(missing), Store(self.store), self.limits), Launch(self.launcher))  # type: ignore[arg-type]
        elif missing and self.fit:
            with progress_bar() as on_progress:
                errors = run_tasks(missing, self.store, self.limits, (unit, ""), on_progress)
            for task in missing:
                if error := errors.get(task.key):
                    print_line(f"{' '.join(task.kind)}: {error}")
        return True

    def write_versions(self, table: str, tasks: Iterable[VersionedTask]) -> None:
        """Write the versions of the methods and systems of a table, next to it."""
        write(self.out / FILE, with_table(self.out, table, {entry for task in tasks for entry in task.used}), self.out)
