"""The atlas of free decays, or of tests with a measured force: ``python -m bench -m experiment=atlas``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from bench.commands.declaration import OneOf, Others, Within
from bench.commands.work import DryRun, Fit, Work, Workers
from bench.config.atlas import SAMPLED, TESTS, atlas_blocks, atlas_methods, atlas_slices, part_names
from bench.errors import InputError
from bench.isolation.machine import usable_cores

if TYPE_CHECKING:
    from bench.atlas.run import PointBlock

COMMAND = "python -m bench -m experiment=atlas"


def _every_method() -> list[str]:
    return list(dict.fromkeys(name for test in TESTS for name in atlas_methods(test)))


def atlas(
    test: Annotated[str, OneOf(tuple(TESTS)), "kind of test"] = "free_decay",
    part: Annotated[tuple[str, ...], "parts of the test, which are points and its slices [all]"] = (),
    method: Annotated[tuple[str, ...], OneOf(_every_method), "methods [all]"] = (),
    points: Annotated[int | None, Within(ge=1), "number of points of the sequence or slice to compute [all]"] = None,
    workers: Workers = None,
    store: Annotated[Path, "folder of finished blocks"] = Path("outputs/atlas"),
    out: Annotated[Path, "folder of the atlas, its tables and maps"] = Path("results"),
    fit: Fit = True,
    launcher: Annotated[
        Sequence[str],
        Others(("hydra/launcher", "hydra", "+hydra")),
        "hydra/launcher=ray or submitit_slurm, whose nodes must share the store; hydra.launcher.<option>=",
    ] = (),
    dry_run: DryRun = False,
) -> int:
    """Compute the atlas: the error of every method over the space of tests.

    Finished blocks are kept in the store, and the same command continues.
    """
    from bench.config.hydra_fields import check_of_hydra
    from bench.engine.pool import Limits

    check_of_hydra(launcher)
    blocks = {name: atlas_blocks(name, method, points, test) for name in part or part_names(test)}
    if not dry_run:
        _import_packages()
    work = Work(store, out, Limits(workers or usable_cores()), fit, dry_run, tuple(launcher))
    if not work.complete([block for of_part in blocks.values() for block in of_part], "fit"):
        return 0
    stated = {"test": test if test != "free_decay" else "", "part": ",".join(part), "points": points or ""}
    _write(test, blocks, work, " ".join([COMMAND, *(f"{k}={v}" for k, v in stated.items() if v)]))
    return 0


def _import_packages() -> None:
    """Import what the atlas is written with, so that a missing package is reported before the work."""
    from bench.atlas.model import ensembles
    from bench.reporting.pictures import maps as _  # noqa: F401

    ensembles()


def _write(test: str, blocks: dict[str, list[PointBlock]], work: Work, command: str) -> None:
    """Write the atlas, its tables and maps, and print their paths."""
    from bench.atlas.point import FreeDecay
    from bench.reporting.atlas import PAGES, atlas_frame, write_atlas, write_compressed
    from bench.reporting.pictures.maps import draw_atlas
    from bench.reporting.pictures.style import save

    out, slices = work.out, [s for s in atlas_slices(test) if s.name in blocks]
    frames = [(s, atlas_frame(blocks[s.name], work.store)) for s in slices]
    stored = [(s, frame) for s, frame in frames if not frame.empty]
    for s, _ in stored:
        work.write_versions(f"atlas_{s.name}", blocks[s.name])
    paths = [write_compressed(frame, out / f"atlas_{s.name}.csv.gz") for s, frame in stored]
    if SAMPLED in blocks:
        frame = atlas_frame(blocks[SAMPLED], work.store)
        if frame.empty:
            raise InputError("store", work.store, "no finished blocks; leave fit=false out to compute them")
        page = next(page for page in PAGES if page.kind is TESTS[test])
        paths += [*write_atlas(frame, page, out, command)]
        work.write_versions(page.name, blocks[SAMPLED])
    if TESTS[test] is FreeDecay:
        paths += [path for pair in stored for path in save(draw_atlas(*pair), out / "figures")]
    print(*paths, sep="\n")
