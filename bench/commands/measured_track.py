"""The measured track: ``python -m bench -m experiment=measured``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

from bench.commands.declaration import OneOf, Within, folder
from bench.commands.work import DryRun, Fit, Work
from bench.config.choices import check_choice
from bench.config.records import track_methods
from bench.records.sets import set_names
from bench.reporting.whole_file import write

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
    dry_run: DryRun = False,
    fit: Fit = True,
) -> int:
    """Fit real records by every method: the measured track, Table 11.

    Finished fits are kept in the store, and the same command goes on from them. A record that is not found is a row
    that says so.
    """
    from bench.engine.pool import Limits
    from bench.records.free_run import free_runs
    from bench.records.sets import measured_set
    from bench.records.track import tasks
    from bench.reporting.tables.track_table import MISSING, TrackPanel, track_table

    root = data_root and folder("data_root", data_root)
    methods = list(method) or track_methods()
    for name in methods:
        check_choice("method", name)
    sets = {name: measured_set(name) for name in set or set_names()}
    fits = {name: list(tasks(name, of, methods, root, float(timeout_s))) for name, of in sets.items()}
    # one fit after another, since the time of a fit is a result
    work = Work(store, out, Limits(memory_mb=MEMORY_MB), fit, dry_run)
    if not work.complete([task for some in fits.values() for task in some], "fit"):
        return 0
    panels = []
    for name, of in sets.items():
        absent = {"status": f"not found under data_root={root or ''}: {of.folder}/{of.files[0]}"}
        for system in of.systems:
            mine = [task for task in fits[name] if task.request.system == system]
            rows = [row for task in mine for row in task.read(store) or [{**task.head, "status": MISSING}]]
            panel = TrackPanel.of_rows(name, of, system, rows or [absent])
            panels.append(replace(panel, free_runs=list(free_runs(of, system, panel.standing, root))))
    for file, content in track_table(panels, COMMAND).items():
        write(out / file, content)
        print(out / file)
    return 0
