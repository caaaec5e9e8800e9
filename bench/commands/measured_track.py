"""The measured track: ``python -m bench -m experiment=measured``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from bench.commands.declaration import OneOf, Within, folder
from bench.commands.work import DryRun, Fit, Work
from bench.config.choices import check_choice
from bench.config.records import track_methods
from bench.records.sets import MeasuredSet, measured_set, set_names
from bench.reporting.whole_file import write

if TYPE_CHECKING:
    from bench.records.track import MeasuredFit
    from bench.reporting.tables.track_table import TrackPanel

COMMAND = "python -m bench -m experiment=measured data_root=<folder>"
MEMORY_MB = 16384.0
"""Memory limit of a fit with its diagnostics (MB)."""


def measured(
    data_root: Annotated[Path | None, "folder of the records that the package does not contain"] = None,
    set: Annotated[tuple[str, ...], OneOf(set_names), "empty: all"] = (),
    method: Annotated[tuple[str, ...], "methods; empty: those of the track"] = (),
    system: Annotated[tuple[str, ...], "systems, or auto; empty: those of the sets"] = (),
    timeout_s: Annotated[int, Within(ge=1), "time limit of a fit (s)"] = 120,
    store: Annotated[Path, "folder of finished fits"] = Path("outputs/measured"),
    out: Annotated[Path, "folder of the table"] = Path("results"),
    dry_run: DryRun = False,
    fit: Fit = True,
) -> int:
    """Fit real records by every method: the measured track, Table 11.

    Finished fits are kept in the store, and the same command continues. A record that is not found is listed as such.
    """
    from bench.engine.pool import Limits
    from bench.records.track import tasks
    from bench.reporting.tables.track_table import track_table

    root = data_root and folder("data_root", data_root)
    methods = list(method) or track_methods()
    for name in methods:
        check_choice("method", name)
    sets = {name: measured_set(name) for name in set or set_names()}
    if system:
        sets = {name: of.model_copy(update={"systems": list(system)}) for name, of in sets.items()}
    fits = {name: list(tasks(name, of, methods, root, float(timeout_s))) for name, of in sets.items()}
    # one fit after another, since the time of a fit is a result
    work = Work(store, out, Limits(memory_mb=MEMORY_MB), fit, dry_run)
    if not work.complete([task for of_set in fits.values() for task in of_set], "fit"):
        return 0
    panels = [panel for name, of in sets.items() for panel in _panels(name, of, fits[name], store, root)]
    for file, content in track_table(panels, COMMAND).items():
        write(out / file, content)
        print(out / file)
    work.write_versions("table11", [task for of_set in fits.values() for task in of_set])
    return 0


def _panels(
    name: str, of: MeasuredSet, fits: Sequence[MeasuredFit], store: Path, root: Path | None
) -> Iterator[TrackPanel]:
    """Yield the panel of each system of a set from the stored fits; missing files are a row of the panel."""
    from bench.records.free_run import free_runs
    from bench.reporting.tables.track_table import NOT_MADE, TrackPanel

    absent = {"status": f"not found under data_root={root or ''}: {of.folder}/{of.files[0]}"}
    for system in of.systems:
        of_system = [fit for fit in fits if fit.request.system == system]
        rows = [row for fit in of_system for row in fit.read(store) or [{**fit.head, "status": NOT_MADE}]]
        panel = TrackPanel.of_rows(name, of, system, rows or [absent])
        yield replace(panel, free_runs=list(free_runs(of, system, panel.rows, root)))
