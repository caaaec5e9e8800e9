"""From a plan to results: on this machine, or by way of a launcher of Hydra's, on Ray or Slurm.

A launcher gets jobs, each with some of the work, and calls :func:`run_job` for each. Results come through the store
alone, which all nodes must see. So a job that is tried again computes only what is missing, and what jobs leave behind,
lost with their node, is launched again as long as that brings anything.
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
from bench.engine.pool import Limits, say
from bench.engine.progress import RunState, progress_bar
from bench.engine.runner import needed
from bench.errors import InputError
from bench.isolation.failure import one_line
from bench.isolation.processes import start_server
from bench.store.cell import Cell
from bench.store.store import Store

CACHE, OWN_CACHE = "XDG_CACHE_HOME", "vibration-bench-launches"
WRITABLE_BY_OTHERS = 0o022
WATCH_S = 1.0
"""Shortest interval at which results are counted; where counting takes long, it gets a twentieth of the time."""


@dataclass(frozen=True)
class Launch:
    """How a run is launched: Hydra's own overrides, if any, and how many cells or blocks a job of a launcher has."""

    overrides: tuple[str, ...] = ()
    cells_per_job: int = 20
    progress: bool = True
    """Whether a bar shows how far the run is."""

    @property
    def launcher(self) -> str:
        """Return the launcher's name."""
        chosen = [text.partition("=")[2] for text in self.overrides if text.lstrip("+").startswith("hydra/launcher=")]
        return chosen[-1] if chosen else "local"

    @property
    def local(self) -> bool:
        """Return whether this process has the work done itself, on the machine's cores."""
        return self.launcher == "local"


def launch(planned: Sequence[Planned], store: Store, limits: Limits, how: Launch) -> None:
    """Have the cells of a plan that are to be run computed and stored; see :func:`launch_job`."""
    launch_job(LaunchJob(tuple(cell for cell in planned if cell.run), store, limits), how)


def launch_job(job: LaunchJob, how: Launch) -> None:
    """Have the tasks of a job computed and stored.

    What jobs elsewhere leave behind is launched again until nothing is left or a round has brought nothing; the store
    then lacks it, and the error stream says why. Raises InputError for a launcher that is unknown or not installed, and
    where the store can no longer be written.
    """
    if not job.tasks:
        return
    if how.local:
        for text in how.overrides:
            if not text.lstrip("+").startswith("hydra/launcher="):
                raise InputError("argument", text, "an option of a launcher: name that too, by hydra/launcher=")
        with progress_bar(how.progress) as on_look:
            job.run(replace(job.limits, preload=preloaded()), on_look)
        return
    folder = job.store.folder.resolve() / "launches" / uuid.uuid4().hex[:12]
    private = make_private_folder()
    try:
        with _launcher(folder, private, how) as launcher, _watched(job, how.progress):
            _rounds(launcher, job, folder, how)
    finally:
        for place in (folder, private):  # jobs that still run elsewhere end when they see it
            shutil.rmtree(place, ignore_errors=True)
        with suppress(OSError):
            folder.parent.rmdir()  # unless another run is under way


def complete(cells: Sequence[Cell], store: Store, limits: Limits) -> None:
    """Compute on this machine, with a progress bar, what the store lacks of some cells."""
    launch(plan(cells, store), store, limits, Launch())


def warm_up(methods: Collection[str]) -> None:
    """Have this machine's server of processes import what the methods need, while the caller goes on."""
    start_server(needed(preloaded(), methods))


def preloaded() -> tuple[str, ...]:
    """Return the packages that ``conf/launch.yaml`` has imported once a run, where a method needs them."""
    from omegaconf import OmegaConf

    return tuple(OmegaConf.create(files("conf").joinpath("launch.yaml").read_text(encoding="utf-8")).preload)


def run_job(config: Any) -> dict[str, int]:
    """Run one job: its tasks that are still to be computed. What every launcher calls."""
    from hydra.core.hydra_config import HydraConfig

    path = Path(config.sweep) / f"{config.job}.job"
    job = read_job(path, path.parents[2])
    limits = replace(job.limits, workers=_cores(HydraConfig.get().launcher), preload=tuple(config.preload))
    left = job.left()

    def on_look(look: RunState) -> None:
        if not path.exists():  # and with it whoever waits for the job
            remedy = "was removed while the sweep ran; start it again, what was stored is kept"
            raise InputError("store", path.parent, remedy)

    job.part(left).run(limits, on_look)
    return {"cells": len(job.tasks), "computed": len(left)}


def _write(path: Path, job: LaunchJob) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        job.write(path)
    except OSError as error:
        raise InputError("store", job.store.folder, f"cannot be written ({error.strerror}); make room") from None


def _cores(launcher: Any) -> int:
    """Return how many workers a job elsewhere has: one for each core that its launcher asks for."""
    ray = launcher.get("ray") or {}
    return int(launcher.get("cpus_per_task") or (ray.get("remote") or {}).get("num_cpus") or 1)


def _rounds(launcher: Any, job: LaunchJob, folder: Path, how: Launch) -> None:
    """Launch what is left of a job, as long as a round brings anything."""
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
                _ = done.return_value  # raises what the job raised
            lost = ""
        except Exception as error:
            if isinstance(error, InputError):
                raise
            lost = one_line(error)
        n_jobs += len(jobs)
        before, left = len(left), job.part(left).left()
        if not left:
            return
        goes_on = "launched again" if len(left) < before else "given up: a round has brought none"
        line = f"hydra/launcher={how.launcher} has left {len(left)} {job.unit}s, {goes_on}"
        say(f"{line} ({lost})" if lost else line)
        if len(left) == before:
            return


def make_private_folder() -> Path:
    """Make a folder that its user alone can write, under the cache: launchers rebuild objects from files in it.

    Raises InputError where the cache (``XDG_CACHE_HOME``, else ``~/.cache``) cannot be written, or others can write.
    """
    cache = os.environ.get(CACHE, "")
    try:
        place = Path(cache or Path.home() / ".cache").resolve() / OWN_CACHE
        place.parent.mkdir(parents=True, exist_ok=True)
        place.mkdir(mode=0o700, exist_ok=True)
        status = place.stat()
        if status.st_uid != os.geteuid() or status.st_mode & WRITABLE_BY_OTHERS:
            raise InputError(CACHE, place, "others can write there; name a folder of your own")
        folder = place / uuid.uuid4().hex
        folder.mkdir(mode=0o700)
    except (OSError, RuntimeError) as error:  # there may be no home folder
        reason = getattr(error, "strerror", None) or "there is no home folder"
        raise InputError(CACHE, cache, f"cannot be written ({reason}); name another folder") from None
    return folder


@contextmanager
def _launcher(folder: Path, private: Path, how: Launch) -> Any:
    """The launcher, composed and set up by Hydra; ``private`` is for files of its own."""
    from hydra import initialize_config_module
    from hydra._internal.callbacks import Callbacks  # what Hydra's own multirun hands to its launchers
    from hydra.core.global_hydra import GlobalHydra
    from hydra.core.plugins import Plugins
    from hydra.core.singleton import Singleton
    from hydra.errors import HydraException
    from hydra.types import HydraContext, RunMode
    from omegaconf.errors import OmegaConfBaseException

    own = [f"sweep={_quoted(folder)}", f"hydra.sweep.dir={_quoted(private)}"]
    if how.launcher == "ray":  # its default for a Ray of its own is refused by a cluster that it joins
        own.append("++hydra.launcher.ray.init.object_store_memory=null")
    state = Singleton.get_state()
    try:
        with initialize_config_module("conf", version_base="1.3", job_name="bench"):
            hydra = GlobalHydra.instance().hydra
            assert hydra is not None
            try:
                config = hydra.compose_config(
                    "launch",
                    [*own, *how.overrides],
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
def _watched(job: LaunchJob, shown: bool) -> Iterator[None]:
    """Show the progress of what is computed elsewhere, by what arrives in the store."""
    over = threading.Event()
    with progress_bar(shown) as on_look:

        def count() -> float:
            started = time.monotonic()
            left = len(job.left())
            done = len(job.tasks) - left
            seconds_left = (started - begun) / done * left if done else math.nan
            on_look(RunState(job.unit, done, len(job.tasks), "", seconds_left, False))
            return time.monotonic() - started

        def watch() -> None:
            took = 0.0
            while not over.wait(max(WATCH_S, 20.0 * took)):
                took = count()

        begun = time.monotonic()
        watcher = threading.Thread(target=watch, daemon=True)
        watcher.start()
        try:
            yield
        finally:
            over.set()
            watcher.join()
            count()
