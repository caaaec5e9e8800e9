"""What a sweep of a million cells takes, from costs measured here on a few.

    python -m tests.studies.sweeps.million

Measures the cost of a cell beside its fits, the size of a stored cell, how fast cells are stored, and what planning,
listing, collecting and loading cost for each cell; then multiplies. Under two minutes, in a temporary folder.
"""

from __future__ import annotations

import os
import platform
import sys
import tempfile
import time
import tracemalloc
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from tabulate import tabulate

from bench.config.experiment import expand
from bench.information.fisher import compute_bound
from bench.run.pool import Limits
from bench.store.bounds import Replicates, load_bounds
from bench.store.cell import Cell
from bench.store.cell_file import FORMAT
from bench.store.seal import sealed, unsealed_text
from bench.store.store import Store
from bench.store.stored import StoredCell
from bench.sweep import launch
from bench.sweep.job import Job, write_job
from bench.sweep.launch import Launch
from bench.sweep.plan import plan
from bench.sweep.runner import run_cells

MILLION = 1_000_000
CORES = 16
NODES = (1, 10, 100)
COMPUTED = 24
"""Cells that are really computed, half a seed each."""
WRITTEN = 400
STORED = 4000
CELLS_PER_JOB = 20
METHODS = 10
"""Methods that share a bound in the table."""
OPERATIONS = 16
"""Steps of a file system that a cell takes, as the source has them: 4 for its claim (open, lock, look, remove), 8 for
its two files (look, open, flush, rename), 3 looks at its state, 1 for the errors of an earlier answer."""
SLOW_S = 1.0
"""A fit of the slow method in the table (s)."""
REPLICATES = 20


@dataclass(frozen=True)
class Costs:
    """Seconds and bytes a cell; ``job_s`` is the start of a job, ``bound_s`` a scenario and seed (for all methods)."""

    job_s: float
    launch_s: float
    bound_s: float
    cell_s: float
    fits_s: float
    json_bytes: float
    arrays_bytes: float
    write_s: float
    make_s: float
    make_bytes: float
    job_bytes: float
    collect_s: float
    plan_s: float
    list_s: float
    load_s: float
    load_bytes: float


def main() -> int:
    """Measure, and print the two tables."""
    started = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        costs = measure(Path(folder))
    load = f"{os.getloadavg()[0]:.1f}"
    print(
        f"measured on {os.cpu_count()} cores ({platform.machine()}), load {load}, {time.monotonic() - started:.0f} s\n"
    )
    print(_measured(costs), _million(costs), sep="\n\n")
    return 0


def measure(folder: Path) -> Costs:
    """All costs, in stores under a folder."""
    cells = _cells(COMPUTED // 2)
    store = Store(folder / "computed")
    store.prepare()
    pairs = list({cell.seed: Replicates(cell.scenario, cell.seed) for cell in cells}.values())
    job_s = _seconds(lambda: load_bounds(pairs[:1], store.bounds))
    compute_bound(*pairs[0])  # the compilation is the process's, not a bound's
    bound_s = _seconds(lambda: [compute_bound(*pair) for pair in pairs[1:]]) / (len(pairs) - 1)
    load_bounds(pairs, store.bounds)
    run_cells(plan(cells[:2], store), store, Limits(1))
    cell_s = _seconds(lambda: run_cells(plan(cells, store), store, Limits(1))) / (len(cells) - 2)
    found = [cell for cell in map(store.load, (one.identity for one in cells)) if cell]
    fits_s = float(np.mean([cell.wall_s for cell in found]))
    sizes = [(store.path(cell.identity).stat().st_size, (store.folder / cell.arrays).stat().st_size) for cell in found]
    json_bytes, arrays_bytes = np.mean(sizes, axis=0)
    started = time.perf_counter()
    many = _cells(STORED // 2)
    names = [cell.identity for cell in many]
    make_s = (time.perf_counter() - started) / STORED
    job = folder / "0.job"
    write_job(job, Job(tuple(plan(many[:20], store)), store, Limits(1)))
    big = Store(folder / "big")
    _fill(big, store.path(found[0].identity).read_bytes(), found[0].identity, many)
    collect_s = _seconds(lambda: list(big.heads())) / STORED
    some = names[:300]
    return Costs(
        job_s=job_s,
        launch_s=_launched(folder),
        bound_s=bound_s,
        cell_s=cell_s,
        fits_s=fits_s,
        json_bytes=json_bytes,
        arrays_bytes=arrays_bytes,
        write_s=_written(Store(folder / "written"), found[0], store.arrays(found[0])),
        make_s=make_s,
        make_bytes=_held(lambda: [(cell, cell.identity) for cell in _cells(STORED // 20)]) / (STORED // 10),
        job_bytes=job.stat().st_size / 20,
        collect_s=collect_s,
        plan_s=_seconds(lambda: plan(many, big)) / STORED,
        list_s=_seconds(lambda: [*os.scandir(big.folder)]) / STORED,
        load_s=_seconds(lambda: [big.load(identity) for identity in some]) / len(some),
        load_bytes=_held(lambda: [big.load(identity) for identity in some]) / len(some),
    )


def _cells(seeds: int) -> list[Cell]:
    texts = ["method=ls,log_decrement", f"seed=range({seeds})", f"replicates={REPLICATES}"]
    return list([job.cell() for job in expand(texts, True)])


def _seconds(step: Callable[[], Any]) -> float:
    started = time.perf_counter()
    step()
    return time.perf_counter() - started


def _written(store: Store, cell: StoredCell, arrays: Any) -> float:
    """Seconds of storing a cell with its arrays, each flushed to disk, by one writer."""
    store.prepare()

    def write() -> None:
        for i in range(WRITTEN):
            store.save(replace(cell, identity=f"{i:020x}"), arrays)

    return _seconds(write) / WRITTEN


def _launched(folder: Path, n: int = 50) -> float:
    """Seconds in which Hydra makes the configuration of one job."""
    with launch._launcher(folder, folder, Launch(("hydra/launcher=basic",))) as launcher:
        loader, config = launcher.hydra_context.config_loader, launcher.config
        return _seconds(lambda: [loader.load_sweep_config(config, [f"job={i}"]) for i in range(n)]) / n


def _held(make: Callable[[], Any]) -> float:
    """Bytes that what is made takes."""
    tracemalloc.start()
    made = make()
    size = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    del made
    return size


def _fill(store: Store, content: bytes, identity: str, cells: Sequence[Cell]) -> None:
    """A store of many cells: one cell's content under the names of all."""
    store.prepare()
    head, _, body = content.partition(b"\n")
    text = unsealed_text(FORMAT, head)
    for cell in cells:
        line = sealed(FORMAT, text.replace(identity, cell.identity))
        store.path(cell.identity).write_bytes(line + b"\n" + body)


def _measured(c: Costs) -> str:
    ms, kb = 1e3, 1e-3
    rows = [
        ["start of a job: a process with jax, the first bound", f"{c.job_s:.1f} s"],
        ["configuration of a job by Hydra, in the driver", f"{ms * c.launch_s:.0f} ms"],
        ["bound of a scenario and seed (shared by all methods)", f"{ms * c.bound_s:.0f} ms"],
        [f"a cell of {REPLICATES} fits on one core", f"{ms * c.cell_s:.0f} ms"],
        ["- of these its fits", f"{ms * c.fits_s:.0f} ms"],
        ["stored cell: .json / .npz", f"{kb * c.json_bytes:.1f} / {kb * c.arrays_bytes:.1f} kB"],
        ["storing it, flushed to disk, one writer", f"{ms * c.write_s:.1f} ms ({1 / c.write_s:.0f} cells/s)"],
        ["making a cell from the command line", f"{ms * c.make_s:.2f} ms, {kb * c.make_bytes:.1f} kB of memory"],
        ["a cell in a job's file", f"{kb * c.job_bytes:.2f} kB"],
        ["reading the head of a cell", f"{ms * c.collect_s:.2f} ms"],
        ["planning a cell", f"{1e6 * c.plan_s:.0f} us"],
        ["listing the folder, a cell", f"{1e6 * c.list_s:.1f} us"],
        ["loading a stored cell whole", f"{ms * c.load_s:.2f} ms, {kb * c.load_bytes:.0f} kB of memory"],
    ]
    return tabulate(rows, headers=["measured", "each"], disable_numparse=True)


def _million(c: Costs) -> str:
    overhead = c.cell_s - c.fits_s
    slow_cell = overhead + REPLICATES * SLOW_S
    shared = c.bound_s / METHODS + c.job_s / CELLS_PER_JOB
    driver = c.make_s + c.plan_s
    gb = MILLION / 1e9
    rows = []
    for nodes in NODES:
        cores = nodes * CORES
        fast_s, slow_s = (MILLION * (each + shared) / cores for each in (c.cell_s, slow_cell))
        rate = MILLION / fast_s
        rows.append([nodes, cores, _time(fast_s), _time(slow_s), f"{rate:.0f}", f"{OPERATIONS * rate:.0f}"])
    headers = ["nodes", "cores", "fast cells", f"{SLOW_S:g} s a fit", "fast cells a second", "file operations a second"]
    fixed = [
        ["driver: making and planning the cells", _time(MILLION * driver)],
        [
            f"driver: configurations of jobs of {CELLS_PER_JOB} / 1000 cells",
            f"{_time(MILLION / CELLS_PER_JOB * c.launch_s)} / {_time(MILLION / 1000 * c.launch_s)}",
        ],
        ["driver: memory for the cells", f"{gb * c.make_bytes:.1f} GB"],
        ["driver: results loaded for the closing table", f"{_time(MILLION * c.load_s)}, {gb * c.load_bytes:.0f} GB"],
        ["jobs' files", f"{gb * c.job_bytes:.1f} GB"],
        ["store", f"{gb * (c.json_bytes + c.arrays_bytes):.0f} GB in 2 million files"],
        ["heads of all cells", _time(MILLION * c.collect_s)],
        ["listing and planning", _time(MILLION * (c.list_s + c.plan_s))],
    ]
    return "\n\n".join(
        [
            f"a million cells of {REPLICATES} fits, {METHODS} methods on the same data, {CELLS_PER_JOB} cells a job",
            tabulate(rows, headers=headers, disable_numparse=True),
            tabulate(fixed, headers=["whatever the number of nodes", ""], disable_numparse=True),
        ]
    )


def _time(seconds: float) -> str:
    for size, unit in ((86400.0, "d"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 1.5 * size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.0f} s"


if __name__ == "__main__":
    sys.exit(main())
