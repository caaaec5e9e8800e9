"""The work of experiments with tasks of their own: the atlas, the online track and the measured track."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from bench.config.fields import MOST_WORKERS
from bench.engine.pool import Limits, StoredTask, run_tasks, say
from bench.engine.progress import progress_bar
from bench.reporting.whole_file import check_folder
from bench.scenario.declaration import Within

Workers = Annotated[int | None, Within(ge=1, le=MOST_WORKERS), "worker processes [one per core]"]
Fit = Annotated[bool, "false: write what is stored"]
DryRun = Annotated[bool, "count what is to be done"]


@dataclass(frozen=True)
class Work:
    """The work of an experiment: where it keeps results and writes tables, whether it computes what is missing.

    ``launcher`` are Hydra's overrides of a launcher, which takes blocks of the atlas alone.
    """

    store: Path
    out: Path
    limits: Limits
    fit: bool = True
    dry_run: bool = False
    launcher: tuple[str, ...] = ()

    def complete(self, tasks: Sequence[StoredTask], unit: str) -> bool:
        """Have the tasks done that the store lacks; returns whether tables are to be written. Raises InputError."""
        if not self.dry_run:
            check_folder(self.store, "store")
            check_folder(self.out)
        missing = [task for task in tasks if not task.stored(self.store)]
        print(f"bench: {sum(task.size for task in tasks):,} {unit}s, {len(missing):,} tasks to do", file=sys.stderr)
        if self.dry_run:
            return False
        if missing and self.fit and self.launcher:
            from bench.engine.job_file import LaunchJob
            from bench.engine.launch import Launch, launch_job
            from bench.store.store import Store

            launch_job(LaunchJob(tuple(missing), Store(self.store), self.limits), Launch(self.launcher))  # type: ignore[arg-type]
        elif missing and self.fit:
            with progress_bar() as on_look:
                errors = run_tasks(missing, self.store, self.limits, (unit, ""), on_look)
            for task in missing:
                if error := errors.get(task.key):
                    say(f"{' '.join(task.kind)}: {error}")
        return True
