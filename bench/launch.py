"""From a plan to finished cells by way of a Hydra launcher: on this machine, on Ray, on Slurm.

A launcher gets jobs, each a range of the sweep's cells, and calls :func:`run_job` for each, wherever it likes. Results
come through the store alone, which all nodes must see; so a job that is tried again computes only what is missing.
"""

from __future__ import annotations

import pickle
import shutil
import sys
import threading
import uuid
from collections.abc import Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bench.cell import Cell
from bench.errors import InputError
from bench.estimate import Status
from bench.plan import Planned, plan
from bench.runner import Limits, run_cells
from bench.store import Store

WATCH_S = 1.0


@dataclass(frozen=True)
class Sweep:
    """All that a job needs to know, beside which cells are its own."""

    cells: tuple[Cell, ...]
    store: Store
    limits: Limits
    retry: frozenset[Status]


@dataclass(frozen=True)
class Launch:
    """How a sweep is launched: Hydra's own overrides, and how many cells a job has where jobs go elsewhere."""

    overrides: tuple[str, ...] = ()
    cells_per_job: int = 20

    @property
    def launcher(self) -> str:
        """The launcher's name."""
        chosen = [text.partition("=")[2] for text in self.overrides if text.lstrip("+").startswith("hydra/launcher=")]
        return chosen[-1] if chosen else "local"


def launch(planned: Sequence[Planned], sweep: Sweep, how: Launch) -> None:
    """Have the cells of a plan that are to be run computed and stored.

    Raises InputError for a launcher that is unknown or not installed, and where the store can no longer be written.
    """
    wanted = tuple(one.cell for one in planned if one.run)
    if not wanted:
        return
    folder = (sweep.store.folder / "launches" / uuid.uuid4().hex[:12]).resolve()
    with _launcher(folder, how, sweep.limits.workers) as launcher:
        store = Store(sweep.store.folder.resolve())
        try:
            folder.mkdir(parents=True)
            (folder / "cells").write_bytes(pickle.dumps(replace(sweep, cells=wanted, store=store)))
        except OSError as error:
            raise InputError("store", store.folder, f"cannot be written ({error.strerror}); make room") from None
        try:
            size = len(wanted) if how.launcher == "local" else how.cells_per_job
            jobs = [
                [f"sweep={_quoted(folder)}", f"first={i}", f"last={min(i + size, len(wanted))}"]
                for i in range(0, len(wanted), size)
            ]
            with _watched(wanted, store, how.launcher != "local"):
                returns = launcher.launch(jobs, 0)
            for done in returns:
                _ = done.return_value  # raises what the job raised
        finally:
            shutil.rmtree(folder, ignore_errors=True)
            with suppress(OSError):
                folder.parent.rmdir()  # unless another sweep is under way


def complete(cells: Sequence[Cell], store: Store, limits: Limits) -> None:
    """Compute on this machine, with a progress bar, what the store lacks of some cells."""
    launch(plan(cells, store), Sweep(tuple(cells), store, limits, frozenset()), Launch())


def run_job(config: Any) -> dict[str, int]:
    """One job: its cells that are still to be computed, each in processes of its own. What every launcher calls."""
    from hydra.core.hydra_config import HydraConfig

    sweep: Sweep = pickle.loads((Path(config.sweep) / "cells").read_bytes())
    cells = sweep.cells[config.first : config.last]
    launcher = HydraConfig.get().launcher
    shown = bool(launcher.get("progress"))  # the local launcher's
    limits = replace(sweep.limits, workers=config.workers, preload=tuple(launcher.get("preload") or ()))
    planned = plan(cells, sweep.store, sweep.retry)
    with _progress(planned, shown) as on_progress:
        run_cells(planned, sweep.store, limits, on_progress)
    return {"cells": len(cells), "computed": sum(one.run for one in planned)}


@contextmanager
def _launcher(folder: Path, how: Launch, workers: int) -> Any:
    """The launcher, composed and set up by Hydra."""
    from hydra import initialize_config_module
    from hydra._internal.callbacks import Callbacks  # what Hydra's own multirun hands to its launchers
    from hydra.core.global_hydra import GlobalHydra
    from hydra.core.plugins import Plugins
    from hydra.core.singleton import Singleton
    from hydra.errors import HydraException
    from hydra.types import HydraContext, RunMode
    from omegaconf.errors import OmegaConfBaseException

    own = [f"sweep={_quoted(folder)}", f"workers={workers if how.launcher == 'local' else 1}"]
    state = Singleton.get_state()
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
            known = [name for name in hydra.config_loader.get_group_options("hydra/launcher")]
            reason = str(error).splitlines()[0]
            if how.launcher not in known:
                reason = f"known: {', '.join(sorted(known))} (pip install 'vibration-bench[ray]' or '[slurm]' for more)"
            raise InputError("hydra/launcher", how.launcher, reason) from None
        yield launcher
    Singleton.set_state(state)


def _quoted(path: Path) -> str:
    return "'" + str(path).replace("\\", "\\\\").replace("'", "\\'") + "'"


@contextmanager
def _progress(planned: Sequence[Planned], shown: bool) -> Any:
    """A progress bar over the fits of a plan; its callback."""
    from tqdm import tqdm

    found = sum(one.cell.replicates for one in planned if not one.run)
    total = found + sum(one.cell.replicates for one in planned if one.run)
    with tqdm(
        total=total, initial=found, unit="fit", file=sys.stderr, dynamic_ncols=True, mininterval=0.2, disable=not shown
    ) as bar:
        bar.set_description("bounds")

        def on_progress(cell: Cell, n: int) -> None:
            bar.set_description(f"{cell.label} {cell.scenario.snr_db:g} dB")
            bar.update(n)

        yield on_progress


@contextmanager
def _watched(cells: Sequence[Cell], store: Store, shown: bool) -> Any:
    """A progress bar over cells that are computed elsewhere: what counts is what arrives in the store."""
    from tqdm import tqdm

    if not shown:
        yield
        return
    before = {cell.identity: _stamp(store, cell) for cell in cells}
    over = threading.Event()
    with tqdm(total=len(cells), unit="cell", file=sys.stderr, dynamic_ncols=True) as bar:

        def watch() -> None:
            while not over.wait(WATCH_S):
                bar.n = _arrived(cells, store, before)
                bar.refresh()

        watcher = threading.Thread(target=watch, daemon=True)
        watcher.start()
        try:
            yield
        finally:
            over.set()
            watcher.join()
            bar.n = _arrived(cells, store, before)
            bar.refresh()


def _stamp(store: Store, cell: Cell) -> int:
    try:
        return store.path(cell.identity).stat().st_mtime_ns
    except OSError:
        return 0


def _arrived(cells: Sequence[Cell], store: Store, before: dict[str, int]) -> int:
    return sum(_stamp(store, cell) != before[cell.identity] for cell in cells)
