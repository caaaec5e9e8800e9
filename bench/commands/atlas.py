"""``python -m bench -m experiment=atlas``: the atlas of free decays, or of tests with a measured force.

Finished blocks are kept in ``store``, and the same command goes on from them. ``fit=false`` writes what is kept.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from bench.commands.fields import flag, listed, path_of, read_fields, whole
from bench.config.atlas import SAMPLED, TESTS, atlas_methods, atlas_slices, part_names
from bench.config.schema import MOST_WORKERS
from bench.errors import InputError
from bench.isolation.cores import usable_cores
from bench.reporting.whole_file import check_folder

if TYPE_CHECKING:
    from bench.atlas.run import Block
    from bench.sweep.job import BlockJob

FIELDS = {
    "test": "free_decay", "part": "", "method": "", "points": "", "workers": "", "store": "outputs/atlas",
    "out": "results", "fit": "true", "dry_run": "false", "shard": "",
}  # fmt: skip
COMMAND = "python -m bench -m experiment=atlas"
USAGE = """usage: python -m bench -m experiment=atlas [field=value ...]

  test      {tests}
  part      [{parts}] several with commas; test=forced has others
  method    {methods}
  points    the first so many points of the sequence or slice
  workers   [one a core] processes
  store     [outputs/atlas] where finished blocks are kept and found again
  out       [results] where the atlas, its tables and maps go
  fit       [true] false: write what is kept
  hydra/launcher
            [local] this machine; ray, submitit_slurm: a cluster, all of whose
            nodes see the store (options of it: hydra.launcher.<name>=<value>)
  shard     3/10: every tenth block from the third on, as a job of many that
            share the store; nothing is written but the blocks. In an array of
            Slurm each job takes its own
  dry_run   [false] say how far it is, what it took, and what is left"""


def atlas_usage() -> str:
    """The page of help."""
    from bench.reporting.terminal import wrapped

    tests = ", ".join(f"[{test}]" if test == FIELDS["test"] else test for test in TESTS)
    text = USAGE.format(tests=tests, parts=",".join(part_names()), methods=", ".join(atlas_methods()))
    return "\n".join(wrapped(line, " " * 12) for line in text.splitlines())


def made_atlas(arguments: Sequence[str]) -> int:
    """Compute what is missing and write the atlas; raises InputError."""
    from bench.run.pool import Limits
    from bench.sweep.job import Atlas, BlockJob

    launcher = tuple(text for text in arguments if text.lstrip("+").startswith(("hydra/launcher=", "hydra.launcher.")))
    fields = read_fields([text for text in arguments if text not in launcher], FIELDS)
    fitting, dry_run = flag("fit", fields["fit"]), flag("dry_run", fields["dry_run"])
    test = fields["test"]
    parts = listed("part", fields["part"]) if fields["part"] else part_names(test)
    methods = listed("method", fields["method"]) if fields["method"] else []
    store, out = path_of(fields["store"]), path_of(fields["out"])
    most = whole("points", fields["points"]) if fields["points"] else None
    workers = whole("workers", fields["workers"], most=MOST_WORKERS) if fields["workers"] else usable_cores()
    number, shards = _shard(fields["shard"])
    atlas = [Atlas(test, part, methods, most) for part in parts]
    tasks = {stated.part: stated.blocks() for stated in atlas}
    if not dry_run:
        check_folder(store, "store")
        if shards == 1:
            check_folder(out)
            _check_packages()
    every = [task for own in tasks.values() for task in own][number - 1 :: shards]
    left = [block for block in every if not block.stored(store)]
    if len(left) == len(every) and not fitting and not dry_run:
        raise InputError("store", store, "a folder with finished blocks; without fit=false they are made")
    fits, left_fits = sum(block.size for block in every), sum(block.size for block in left)
    print(f"bench: {fits:,} fits in {len(every):,} blocks, {left_fits:,} in {len(left):,} to do", file=sys.stderr)
    if dry_run:
        print(_progress(every, store, workers))
        return 0
    if left and fitting:
        _run(BlockJob(tuple(left), tuple(atlas), store, Limits(workers)), launcher)
    if shards > 1:
        return 0
    told = [f"{name}={fields[name]}" for name in ("test", "part", "points") if fields[name] != FIELDS[name]]
    return _write(test, tasks, store, out, " ".join([COMMAND, *told]))


def _check_packages() -> None:
    """Raise InputError before the work where the atlas could not be written after it."""
    from bench.atlas.model import ensembles

    ensembles()
    try:
        import matplotlib  # noqa: F401
    except ModuleNotFoundError as error:
        raise InputError("package", error.name, "installed: pip install 'vibration-bench[figures]'") from None


def _shard(text: str) -> tuple[int, int]:
    """The number of a shard, from 1, and of all; of no text, this job's in an array of Slurm, or all there is."""
    if not text and "SLURM_ARRAY_TASK_ID" in os.environ:
        first = int(os.environ.get("SLURM_ARRAY_TASK_MIN", "1"))
        return int(os.environ["SLURM_ARRAY_TASK_ID"]) - first + 1, int(os.environ.get("SLURM_ARRAY_TASK_COUNT", "1"))
    text = text or "1/1"
    number, _, shards = text.partition("/")
    if not re.fullmatch(r"[0-9]{1,6}/[0-9]{1,6}", text) or not 1 <= int(number) <= int(shards):
        raise InputError("shard", text, "<number>/<of how many>, as 3/10")
    return int(number), int(shards)


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


def _run(job: BlockJob, launcher: tuple[str, ...]) -> None:
    from bench.sweep.launch import Launch, launch_job

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
