"""From a plan to finished cells: on this machine, or by way of a launcher of Hydra's, on Ray or Slurm.

A launcher gets jobs, each with some of the sweep's cells, and calls :func:`run_job` for each, wherever it likes.
Results come through the store alone, which all nodes must see. So a job that is tried again computes only what is
missing, and what jobs leave behind, lost with their node, is launched again as long as that brings anything.
"""

from __future__ import annotations

import os
import shutil
import sys
import threading
import time
import uuid
from collections.abc import Collection, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

from bench.errors import InputError
from bench.isolation.failure import one_line
from bench.isolation.private import make_private_folder
from bench.isolation.processes import start_server
from bench.store.archive.archive import Archive
from bench.store.cell import Cell
from bench.store.store import Store
from bench.sweep.job import Job, read_job, write_job
from bench.sweep.plan import Planned, plan
from bench.sweep.progress import Look
from bench.sweep.progress_bar import progress_bar
from bench.sweep.runner import needed, run_cells
from bench.sweep.workers import Limits

WATCH_S = 1.0
"""How often arrivals are counted, at most; where counting takes long, a twentieth of the time goes into it."""


@dataclass(frozen=True)
class Launch:
    """How a sweep is launched: Hydra's own overrides, if any, and how many cells a job of a launcher has."""

    overrides: tuple[str, ...] = ()
    cells_per_job: int = 20
    progress: bool = True
    """Whether a bar shows how far the sweep is."""

    @property
    def launcher(self) -> str:
        """The launcher's name."""
        chosen = [text.partition("=")[2] for text in self.overrides if text.lstrip("+").startswith("hydra/launcher=")]
        return chosen[-1] if chosen else "local"

    @property
    def local(self) -> bool:
        """Whether this process has the cells computed itself, on the machine's cores."""
        return self.launcher == "local"


def launch(planned: Sequence[Planned], store: Store, limits: Limits, how: Launch) -> None:
    """Have the cells of a plan that are to be run computed and stored.

    Cells that jobs elsewhere leave behind are launched again until none is left or a round has brought none; the store
    then lacks them, and the error stream says why. Raises InputError for a launcher that is unknown or not installed,
    and where the store can no longer be written.
    """
    wanted = tuple(one for one in planned if one.run)
    if not wanted:
        return
    if how.local:
        _run_here(wanted, store, limits, how)
        return
    store = Store(store.folder.resolve(), store.archive and Archive(store.archive.folder.resolve()))
    folder = store.folder / "launches" / uuid.uuid4().hex[:12]
    sweep = Job(wanted, store, limits)
    private = make_private_folder()
    try:
        with _launcher(folder, private, how) as launcher, _watched(sweep, how.progress):
            _rounds(launcher, sweep, folder, how)
    finally:
        for own in (folder, private):  # jobs that still run elsewhere end when they see it
            shutil.rmtree(own, ignore_errors=True)
        with suppress(OSError):
            folder.parent.rmdir()  # unless another sweep is under way


def complete(cells: Sequence[Cell], store: Store, limits: Limits) -> None:
    """Compute on this machine, with a progress bar, what the store lacks of some cells."""
    launch(plan(cells, store), store, limits, Launch())


def warm_up(methods: Collection[str]) -> None:
    """Have this machine's server of processes import what the methods need, while the caller goes on."""
    start_server(needed(preloaded(), methods))


def preloaded() -> tuple[str, ...]:
    """The packages that ``conf/launch.yaml`` has imported once a run, where a method needs them."""
    from omegaconf import OmegaConf

    return tuple(OmegaConf.create(files("conf").joinpath("launch.yaml").read_text(encoding="utf-8")).preload)


def _run_here(wanted: Sequence[Planned], store: Store, limits: Limits, how: Launch) -> None:
    for text in how.overrides:
        if not text.lstrip("+").startswith("hydra/launcher="):
            raise InputError("argument", text, "an option of a launcher: name that too, by hydra/launcher=")
    with progress_bar(how.progress) as on_look:
        run_cells(wanted, store, replace(limits, preload=preloaded()), on_look)


def run_job(config: Any) -> dict[str, int]:
    """One job: its cells that are still to be computed, each in processes of its own. What every launcher calls."""
    from hydra.core.hydra_config import HydraConfig

    path = Path(config.sweep) / f"{config.job}.job"
    job = read_job(path, path.parents[2])
    limits = replace(job.limits, workers=_cores(HydraConfig.get().launcher), preload=tuple(config.preload))
    left = job.left()

    def on_look(look: Look) -> None:
        if not path.exists():  # and with it whoever waits for the job
            remedy = "was removed while the sweep ran; start it again, what was stored is kept"
            raise InputError("store", path.parent, remedy)

    run_cells(left, job.store, limits, on_look)
    return {"cells": len(job.planned), "computed": len(left)}


def _write(path: Path, job: Job) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_job(path, job)
    except OSError as error:
        raise InputError("store", job.store.folder, f"cannot be written ({error.strerror}); make room") from None


def _cores(launcher: Any) -> int:
    """How many cells a job elsewhere computes at once: one for each core that its launcher asks for."""
    ray = launcher.get("ray") or {}
    return int(launcher.get("cpus_per_task") or (ray.get("remote") or {}).get("num_cpus") or 1)


def _rounds(launcher: Any, sweep: Job, folder: Path, how: Launch) -> None:
    """Launch what is left of a sweep, as long as a round brings anything."""
    n_jobs, left = 0, list(sweep.planned)
    size = how.cells_per_job
    while left:
        jobs: list[list[str]] = []
        for i in range(0, len(left), size):
            name = n_jobs + len(jobs)
            _write(folder / f"{name}.job", sweep.part(left[i : i + size]))
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
        before, left = len(left), _left(sweep, left)
        if not left:
            return
        goes_on = "launched again" if len(left) < before else "given up: a round has brought none"
        said = f"bench: hydra/launcher={how.launcher} has left {len(left)} cells, {goes_on}"
        print(f"{said} ({lost})" if lost else said, file=sys.stderr)
        if len(left) == before:
            return


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
    if how.local and not how.progress:
        own.append("hydra.launcher.progress=false")
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
def _watched(sweep: Job, shown: bool) -> Any:
    """A progress bar over cells that are computed elsewhere: what counts is what arrives in the store."""
    from tqdm.auto import tqdm

    over = threading.Event()
    with tqdm(total=len(sweep.planned), unit="cell", file=sys.stderr, dynamic_ncols=True, disable=not shown) as bar:

        def count() -> float:
            started = time.monotonic()
            bar.n = len(sweep.planned) - len(_left(sweep, sweep.planned))
            bar.refresh()
            return time.monotonic() - started

        def watch() -> None:
            took = 0.0
            while not over.wait(max(WATCH_S, 20.0 * took)):
                took = count()

        watcher = threading.Thread(target=watch, daemon=True)
        watcher.start()
        try:
            yield
        finally:
            over.set()
            watcher.join()
            count()


def _left(sweep: Job, planned: Sequence[Planned]) -> list[Planned]:
    """As :meth:`Job.left`, of many cells: one listing of the store, and a look only at cells that were there before."""
    there = {entry.name for entry in os.scandir(sweep.store.folder)}

    def left(one: Planned) -> bool:
        identity = one.cell.identity
        return f"{identity}.json" not in there or bool(one.stamp and sweep.store.stamp(identity) == one.stamp)

    return [one for one in planned if left(one)]
