"""The measured track: ``python -m bench -m experiment=measured``."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from bench.commands.declaration import OneOf, Within, folder
from bench.commands.work import DryRun, Fit, Work
from bench.config.choices import check_choice
from bench.config.records import track_methods
from bench.records.sets import set_names
from bench.reporting.whole_file import check_file, write

if TYPE_CHECKING:
    from bench.records.track import MeasuredFit, TrackFit
    from bench.reporting.tables.track_table import FreeRun, Track, TrackPanel

COMMAND = "python -m bench -m experiment=measured data_root=<folder>"
MEMORY_MB = 16384.0
"""Limit of a fit with its diagnostics, whose processes have limits of their own."""


def measured(
    data_root: Annotated[Path | None, "where records lie that do not travel with the package"] = None,
    set: Annotated[tuple[str, ...], OneOf(set_names), "empty: all"] = (),
    method: Annotated[tuple[str, ...], "methods; empty: those of the track"] = (),
    timeout_s: Annotated[int, Within(ge=1), "s, limit of a fit"] = 120,
    store: Annotated[Path, "folder of finished fits"] = Path("outputs/measured"),
    out: Annotated[Path, "folder of the table"] = Path("results"),
    page: Annotated[Path, "the same as a page with pictures"] = Path("build/table11.html"),
    dry_run: DryRun = False,
    fit: Fit = True,
) -> int:
    """Fit real records by every method: the measured track, Table 11.

    Finished fits are kept in the store, and the same command goes on from them. A record that is not found is a row
    that says so.
    """
    from bench.engine.pool import Limits
    from bench.records.sets import measured_set
    from bench.records.track import read_fit, tasks
    from bench.reporting.tables.track_table import Track

    root, names = data_root and folder("data_root", data_root), set or set_names()
    methods = list(method) or track_methods()
    for name in methods:
        check_choice("method", name)
    if not dry_run:
        check_file(page, "page")
    by_set = {name: list(tasks(name, measured_set(name), methods, root, float(timeout_s))) for name in names}
    # one fit after another, since the time of a fit is a result
    work = Work(store, out, Limits(memory_mb=MEMORY_MB), fit, dry_run)
    if not work.complete([task for fits in by_set.values() for task in fits], "fit"):
        return 0
    panels, missing = [], 0
    for name, wanted in by_set.items():
        missing += sum(not task.stored(store) for task in wanted)
        fits = [stored for task in wanted if (stored := read_fit(store, task.key))]
        panels += _panels(name, wanted, fits, root)
    free_runs = [free_run for panel in panels for free_run in _free_runs(panel, root)]
    _write(Track(panels, free_runs, missing), out, page)
    return 0


def _panels(name: str, own: Sequence[MeasuredFit], fits: Sequence[TrackFit], root: Path | None) -> list[TrackPanel]:
    """A panel a system of a set; one that says so where its files are not there."""
    from bench.records.sets import measured_set
    from bench.reporting.tables.track_table import TrackPanel

    of = measured_set(name)
    if not own:
        place = f"{of.folder}/{of.files[0]}"
        said = f"not found under data_root={root or ''}: {place}" if root else f"not found under data_root=: {place}"
        return [TrackPanel(name, of, system, absent=said) for system in of.systems]
    return [TrackPanel(name, of, system, [fit for fit in fits if fit.system == system]) for system in of.systems]


def _free_runs(panel: TrackPanel, root: Path | None) -> Iterator[FreeRun]:
    """Models simulated over the test parts: shooting's, at its median parameters, and what others have published."""
    import numpy as np

    from bench.config.records import primary_method
    from bench.records.free_run import free_run_error, part_problem
    from bench.reporting.tables.track_table import FreeRun

    place = panel.of.place(root)
    if panel.absent or not panel.of.tests or place is None:
        return
    parts = [part_problem(panel.of, panel.system, part, place) for part in panel.of.tests.values()]
    names = parts[0][0].names
    models = {}
    found = [fit for fit in panel.own(primary_method()) if set(names) <= set(fit.estimates)]
    if found:
        offset = float(np.nanmedian([fit.offset for fit in found]))
        p = {name: float(np.median([fit.estimates[name].value for fit in found])) for name in names}
        models[f"shooting, median of {len(found)} siblings"] = p, offset
    if set(names) <= set(panel.of.known):
        models["published parameters"] = {name: panel.of.known[name].value for name in names}, 0.0
    for model, (p, offset) in models.items():
        errors = [free_run_error(system, p, record, offset, panel.of.unscored) for system, record in parts]
        yield FreeRun(f"{panel.name} {panel.system}", model, tuple(1e3 * error for error in errors))


def _write(track: Track, out: Path, place: Path) -> None:
    """The table, and where the packages of the page are there, the page."""
    from bench.reporting.tables.track_table import track_table

    made = {out / name: content for name, content in track_table(track, COMMAND).items()}
    try:
        from bench.reporting.track.page import page

        made[place] = page(track, COMMAND)
    except ImportError as error:
        said = f"bench: no page, since {error.name} is missing: pip install 'vibration-bench[report]'"
        print(said, file=sys.stderr)
    for path, content in made.items():
        write(path, content)
        print(path)
