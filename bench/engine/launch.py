"""Launching of a plan: on this machine, or by a Hydra launcher on Ray or Slurm.

A launcher gets jobs, each with part of the work, and calls :func:`run_job` for each. Results are returned through the
store only, which all nodes must share. A repeated job computes only what is missing, and tasks lost with a node are
launched again as long as a round completes any.
"""

from __future__ import annotations

import math
import os
import shutil
import threading
import time
import uuid
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

from bench.engine.job_file import LaunchJob, read_job
from bench.engine.plan import Planned, plan
from bench.engine.pool import Limits, print_line
from bench.engine.progress import RunState, progress_bar
from bench.engine.runner import needed
from bench.errors import InputError
from bench.isolation.failure import one_line
from bench.isolation.processes import start_server
from bench.store.cell import Cell
from bench.store.store import Store

CACHE, CACHE_FOLDER = "XDG_CACHE_HOME", "vibration-bench-launches"
WRITABLE_BY_OTHERS = 0o022
WATCH_S = 1.0
"""Shortest interval between counts of the stored results (s); counting takes at most a twentieth of the time."""


@dataclass(frozen=True)
class Launch:
    """Options of a launch: overrides of Hydra's fields, cells or blocks per job, and whether progress is shown."""

    overrides: tuple[str, ...] = ()
    cells_per_job: int = 20
    progress: bool = True

    @property
    def launcher(self) -> str:
        """The name of the launcher."""
        chosen = [text.partition("=")[2] for text in self.overrides if text.lstrip("+").startswith("hydra/launcher=")]
        return chosen[-1] if chosen else "local"

    @property
    def local(self) -> bool:
        """True if the work is done by worker processes on this machine."""
        return self.launcher == "local"


def launch(planned: Sequence[Planned], store: Store, limits: Limits, how: Launch) -> None:
    """Compute and store the cells of a plan that are to be run; see :func:`launch_job`."""
    launch_job(LaunchJob(tuple(cell for cell in planned if cell.run), store, limits), how)


def launch_job(job: LaunchJob, how: Launch) -> None:
    """Compute and store the tasks of a job.

    Tasks that a launcher's jobs leave unfinished are launched again until none is left or a round completes none; the
    reason is then printed to the error stream.

    Raises:
        InputError: The launcher is unknown or not installed, or the store cannot be written.
    """
    if not job.tasks:
        return
    if how.local:
        for text in how.overrides:
            if not text.lstrip("+").startswith("hydra/launcher="):
                raise InputError("argument", text, "an option of a launcher requires hydra/launcher=<name>")
        with progress_bar(how.progress) as on_progress:
            job.run(replace(job.limits, preload=preloaded()), on_progress)
        return
    folder = job.store.folder.resolve() / "launches" / uuid.uuid4().hex[:12]
    private = make_private_folder()
    try:
        with _launcher(folder, private, how) as launcher, _progress_of_store(job, how.progress):
            _launch_rounds(launcher, job, folder, how)
    finally:
        for path in (folder, private):  # jobs that still run elsewhere end when their file is removed
            shutil.rmtree(path, ignore_errors=True)
        with suppress(OSError):
            folder.parent.rmdir()  # fails if another run uses it


def complete(cells: Sequence[Cell], store: Store, limits: Limits) -> None:
    """Compute the cells that are missing in the store, on this machine, with a progress bar."""
    launch(plan(cells, store), store, limits, Launch())


def warm_up(methods: Collection[str]) -> None:
    """Start the server of worker processes, which imports the packages of the methods in the background."""
    start_server(needed(preloaded(), methods))


def preloaded() -> tuple[str, ...]:
    """Return the packages of ``conf/launch.yaml`` that are imported once per run if a method requires them."""
    from omegaconf import OmegaConf

    return tuple(OmegaConf.create(files("conf").joinpath("launch.yaml").read_text(encoding="utf-8")).preload)


def run_job(config: Any) -> dict[str, int]:
    """Run the unfinished tasks of one job; this is the function that a launcher calls."""
    from hydra.core.hydra_config import HydraConfig

    path = Path(config.sweep) / f"{config.job}.job"
    job = read_job(path, path.parents[2])
    limits = replace(job.limits, workers=_cores(HydraConfig.get().launcher), preload=tuple(config.preload))
    left = job.left()

    def on_progress(look: RunState) -> None:
        if not path.exists():  # the run that launched the job has ended
            remedy = "was removed during the sweep; start it again, stored cells are kept"
            raise InputError("store", path.parent, remedy)

    job.part(left).run(limits, on_progress)
    return {"cells": len(job.tasks), "computed": len(left)}


def _write(path: Path, job: LaunchJob) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        job.write(path)
    except OSError as error:
        raise InputError("store", job.store.folder, f"cannot be written ({error.strerror}); free disk space") from None


def _cores(launcher: Any) -> int:
    """Return the number of cores that a launcher requests per job."""
    ray = launcher.get("ray") or {}
    return int(launcher.get("cpus_per_task") or (ray.get("remote") or {}).get("num_cpus") or 1)


def _launch_rounds(launcher: Any, job: LaunchJob, folder: Path, how: Launch) -> None:
    """Launch the unfinished tasks repeatedly, as long as a round completes any."""
    n_jobs, left = 0, list(job.tasks)
    size = how.cells_per_job
    while left:
        jobs: list[list[str]] = []
        for i in range(0, len(left), size):
            name = n_jobs + len(jobs)
            _write(folder / f"{name}.job", job.part(left[i : i + size]))
            jobs.append([f"sweep={_quoted(folder)}", f"job={name}"])
        try:
            returns = launcher.launch(jobs, n_jobs)
            for done in returns:
                _ = done.return_value  # raises the exception of the job
            reason = ""
        except Exception as error:
            if isinstance(error, InputError):
                raise
            reason = one_line(error)
        n_jobs += len(jobs)
        before, left = len(left), job.part(left).left()
        if not left:
            return
        action = "launching them again" if len(left) < before else "giving up, since the last round completed none"
        line = f"hydra/launcher={how.launcher}: {len(left)} {job.unit}s unfinished, {action}"
        print_line(f"{line} ({reason})" if reason else line)
        if len(left) == before:
            return


def make_private_folder() -> Path:
    """Make a folder in the cache that only this user can write, since launchers unpickle files in it.

    Raises:
        InputError: The cache (``XDG_CACHE_HOME``, else ``~/.cache``) cannot be written, or others can write in it.
    """
    cache = os.environ.get(CACHE, "")
    try:
        base = Path(cache or Path.home() / ".cache").resolve() / CACHE_FOLDER
        base.parent.mkdir(parents=True, exist_ok=True)
        base.mkdir(mode=0o700, exist_ok=True)
        status = base.stat()
        if status.st_uid != os.geteuid() or status.st_mode & WRITABLE_BY_OTHERS:
            raise InputError(CACHE, base, "other users can write there; use a folder that only you can write")
        folder = base / uuid.uuid4().hex
        folder.mkdir(mode=0o700)
    except (OSError, RuntimeError) as error:  # there may be no home folder
        reason = getattr(error, "strerror", None) or "no home folder"
        raise InputError(CACHE, cache, f"cannot be written ({reason}); use another folder") from None
    return folder


@contextmanager
def _launcher(folder: Path, private: Path, how: Launch) -> Any:
    """Yield the launcher that Hydra sets up; ``private`` is the folder of its own files."""
    from hydra import initialize_config_module
    from hydra._internal.callbacks import Callbacks  # required by launchers; Hydra has no public equivalent
    from hydra.core.global_hydra import GlobalHydra
    from hydra.core.plugins import Plugins
    from hydra.core.singleton import Singleton
    from hydra.errors import HydraException
    from hydra.types import HydraContext, RunMode
    from omegaconf.errors import OmegaConfBaseException

    fixed = [f"sweep={_quoted(folder)}", f"hydra.sweep.dir={_quoted(private)}"]
    if how.launcher == "ray":  # an existing Ray cluster rejects the launcher's default
        fixed.append("++hydra.launcher.ray.init.object_store_memory=null")
    state = Singleton.get_state()
    try:
        with initialize_config_module("conf", version_base="1.3", job_name="bench"):
            hydra = GlobalHydra.instance().hydra
            assert hydra is not None
            try:
                config = hydra.compose_config(
                    "launch",
                    [*fixed, *how.overrides],
                    run_mode=RunMode.MULTIRUN,
                    from_shell=False,
                    with_log_configuration=False,
                )
                context = HydraContext(config_loader=hydra.config_loader, callbacks=Callbacks(config))
                launcher = Plugins.instance().instantiate_launcher(
                    hydra_context=context, task_function=run_job, config=config
                )
            except (HydraException, OmegaConfBaseException, ImportError) as error:
                known = ["local", *hydra.config_loader.get_group_options("hydra/launcher")]
                reason = str(error).splitlines()[0]
                if how.launcher not in known:
                    reason = (
                        f"known: {', '.join(sorted(known))} (pip install 'vibration-bench[ray]' or '[slurm]' for more)"
                    )
                raise InputError("hydra/launcher", how.launcher, reason) from None
            yield launcher
    finally:
        Singleton.set_state(state)


def _quoted(path: Path) -> str:
    return "'" + str(path).replace("\\", "\\\\").replace("'", "\\'") + "'"


@contextmanager
def _progress_of_store(job: LaunchJob, shown: bool) -> Iterator[None]:
    """Show the progress of jobs elsewhere by the results that arrive in the store."""
    over = threading.Event()
    with progress_bar(shown) as on_progress:

        def count() -> float:
            started = time.monotonic()
            left = len(job.left())
            done = len(job.tasks) - left
            seconds_left = (started - beginning) / done * left if done else math.nan
            on_progress(RunState(job.unit, done, len(job.tasks), "", seconds_left, False))
            return time.monotonic() - started

        def watch() -> None:
            seconds = 0.0
            while not over.wait(max(WATCH_S, 20.0 * seconds)):
                seconds = count()

        beginning = time.monotonic()
        watcher = threading.Thread(target=watch, daemon=True)
        watcher.start()
        try:
            yield
        finally:
            over.set()
            watcher.join()
            count()
