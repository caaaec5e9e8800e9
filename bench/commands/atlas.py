"""The atlas of free decays, or of tests with a measured force: ``python -m bench -m experiment=atlas``."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from bench.commands.declaration import Choice, Others, Within
from bench.config.atlas import SAMPLED, TESTS, atlas_blocks, atlas_methods, atlas_slices, part_names
from bench.config.fields import MOST_WORKERS
from bench.config.of_hydra import check_of_hydra
from bench.errors import InputError
from bench.isolation.machine import usable_cores
from bench.reporting.whole_file import check_folder

if TYPE_CHECKING:
    from bench.atlas.run import Block
    from bench.engine.job_file import LaunchJob

COMMAND = "python -m bench -m experiment=atlas"


def _every_method() -> list[str]:
    return list(dict.fromkeys(name for test in TESTS for name in atlas_methods(test)))


def atlas(
    test: Annotated[str, Choice(tuple(TESTS)), "kind of test"] = "free_decay",
    part: Annotated[tuple[str, ...], "empty: all parts of the test, which are points and its slices"] = (),
    method: Annotated[tuple[str, ...], Choice(_every_method), "empty: all"] = (),
    points: Annotated[int | None, Within(ge=1), "the first so many points of the sequence or slice"] = None,
    workers: Annotated[int | None, Within(ge=1, le=MOST_WORKERS), "processes; empty: one a core"] = None,
    store: Annotated[Path, "folder of finished blocks"] = Path("outputs/atlas"),
    out: Annotated[Path, "folder of the atlas, its tables and maps"] = Path("results"),
    fit: Annotated[bool, "false: write what is stored"] = True,
    launcher: Annotated[
        Sequence[str],
        Others(("hydra/launcher", "hydra", "+hydra")),
        "hydra/launcher=ray, submitit_slurm: a cluster, all of whose nodes see the store; hydra.launcher.<option>=",
    ] = (),
    dry_run: Annotated[bool, "say how far it is, what it took, and what is left"] = False,
) -> int:
    """Compute the atlas: the error of every method over the space of tests, or what is missing of it.

    Finished blocks are kept in the store, and the same command goes on from them.
    """
    from bench.engine.job_file import LaunchJob
    from bench.engine.pool import Limits
    from bench.store.store import Store

    check_of_hydra(launcher)
    tasks = {name: atlas_blocks(name, method, points, test) for name in part or part_names(test)}
    workers = workers or usable_cores()
    if not dry_run:
        check_folder(store, "store")
        check_folder(out)
        _check_packages()
    every = [task for own in tasks.values() for task in own]
    left = [block for block in every if not block.stored(store)]
    if len(left) == len(every) and not fit and not dry_run:
        raise InputError("store", store, "a folder with finished blocks; without fit=false they are made")
    fits, left_fits = sum(block.size for block in every), sum(block.size for block in left)
    print(f"bench: {fits:,} fits in {len(every):,} blocks, {left_fits:,} in {len(left):,} to do", file=sys.stderr)
    if dry_run:
        print(_progress(every, store, workers))
        return 0
    if left and fit:
        _run(LaunchJob(tuple(left), Store(store), Limits(workers)), tuple(launcher))
    chosen = {"test": test if test != "free_decay" else "", "part": ",".join(part), "points": points or ""}
    return _write(test, tasks, store, out, " ".join([COMMAND, *(f"{k}={v}" for k, v in chosen.items() if v)]))


def _check_packages() -> None:
    """Raise InputError before the work where the atlas could not be written after it."""
    from bench.atlas.model import ensembles

    ensembles()
    try:
        import matplotlib  # noqa: F401
    except ModuleNotFoundError as error:
        raise InputError("package", error.name, "installed: pip install 'vibration-bench[figures]'") from None


NODES = (1, 10, 100)


def _progress(blocks: Sequence[Block], store: Path, workers: int) -> str:
    """How far each method is, and what the whole takes on one machine and on many."""
    from bench.atlas.cost import hours, progress
    from bench.reporting.terminal import table, wrapped

    lines = progress(blocks, store)
    rows = [
        [one.label, f"{one.done} of {one.blocks}", f"{one.fits_done:,} of {one.fits:,}",
         f"{1e3 * one.fit_s:.1f}" if one.done else "-", f"{one.fits_done * one.fit_s / 3600:.2f}" if one.done else "-",
         f"{(one.fits - one.fits_done) * one.fit_s / 3600:.2f}" if one.done else "-"]
        for one in lines
    ]  # fmt: skip
    text = table(rows, ["method", "blocks", "fits", "ms a fit", "hours of a core", "left"])
    known = {one.label: one.fit_s for one in lines if one.done}
    measured = [block for block in blocks if block.label in known]
    if not measured:
        return text
    took = ", ".join(f"{hours(measured, known, n * workers):.2g}" for n in NODES)
    nodes = ", ".join(map(str, NODES))
    whole = f"Whole, for the methods with a time, on {nodes} nodes with {workers} workers each: {took} hours."
    return f"{text}\n\n{wrapped(whole, '')}"


def _run(job: LaunchJob, launcher: tuple[str, ...]) -> None:
    from bench.engine.launch import Launch, launch_job

    launch_job(job, Launch(launcher))


def _write(test: str, tasks: dict[str, list[Block]], store: Path, out: Path, again: str) -> int:
    from bench.reporting.atlas import PAGES, atlas_frame, packed, written
    from bench.reporting.figures.atlas import draw_atlas
    from bench.reporting.figures.atlas_regions import draw_regions

    every = atlas_slices(test)
    if SAMPLED in tasks:
        frame = atlas_frame(tasks[SAMPLED], store)
        if frame.empty:
            raise InputError("store", store, "a folder with finished blocks; without fit=false they are made")
        page = next(page for page in PAGES if page.kind is TESTS[test])
        for place in [*written(frame, page, out, again), *(draw_regions(every, frame, out) if page.modelled else [])]:
            print(place)
    slices = {s.name: s for s in every if s.name in tasks}
    frames = {name: atlas_frame(tasks[name], store) for name in slices}
    there = [(slices[name], frame) for name, frame in frames.items() if not frame.empty]
    for place in [*(packed(frame, out / f"atlas_{own.name}.csv.gz") for own, frame in there), *draw_atlas(there, out)]:
        print(place)
    return 0
