"""What failed where: the share of failed replicates of the methods that failed on a system, by status."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.contract.estimate import Status
from bench.entrants.reference import REFERENCES
from bench.reporting.figures.gallery import Gallery, Nothing, Picture
from bench.reporting.figures.style import FULL, MM, SMALL, entry, legend_below, pyplot, width_of
from bench.reporting.frame import Result
from bench.reporting.rounding import readable

LETTERS = {
    Status.DIVERGED: "d", Status.NONFINITE: "n", Status.TIMEOUT: "t", Status.KILLED: "k", Status.OOM: "o",
    Status.CRASHED: "c", Status.INVALID: "i",
}  # fmt: skip
NOT_TRIED = (Status.UNSUPPORTED, Status.MISSING_DEPENDENCY)
"""Not failures of a fit: the method says that it cannot, or its package is not there."""
CELL = 6.6
"""Height of a row (mm): a number and its letter, one above the other."""
MOST = 60
"""Rows shown at most: those with most failures."""
Scene = tuple[str, str]
"""A system and what disturbs it: a row, at its noise level and start with most failures of each method."""


@dataclass(frozen=True)
class Share:
    """Of the replicates of a method: how many of those tried failed, the status of most, and why not tried, if so."""

    failed: float
    status: Status | None
    absent: Status | None


def share(cell: Result) -> Share:
    """The share of a cell."""
    counted = Counter(cell.statuses)
    absent = max((s for s in NOT_TRIED if counted[s]), key=lambda s: counted[s], default=None)
    failed = {status: counted[status] for status in LETTERS if counted[status]}
    total = sum(failed.values()) / cell.n if cell.n else 0.0
    return Share(total, max(failed, key=lambda s: failed[s], default=None), absent)


def worst(cells: Sequence[Result]) -> dict[tuple[Scene, str], Share]:
    """By row and method, the share of the cell with most failures; not tried only if no cell of it was."""
    found: dict[tuple[Scene, str], Share] = {}
    for cell in cells:
        at, own = ((cell.system, cell.disturbance), cell.label), share(cell)
        kept = found.get(at)
        if kept is None or (own.failed, own.absent is None) > (kept.failed, kept.absent is None):
            found[at] = own
    return found


def draw_failures(gallery: Gallery) -> Picture:
    """A heat map, a row a system and a column a method, of those rows and columns in which something failed."""
    found = worst(gallery.cells)
    bad = Counter[Scene]()
    for (scene, _), own in found.items():
        bad[scene] += round(1e6 * own.failed)
    rows = sorted(sorted((scene for scene in bad if bad[scene]), key=lambda scene: -bad[scene])[:MOST])
    if not rows:
        raise Nothing("no replicate of any cell failed")
    failed = {at for at, own in found.items() if own.failed}
    columns = [label for label in gallery.looks if any((row, label) in failed for row in rows)]
    grid = {
        (rows.index(scene), columns.index(label)): own
        for (scene, label), own in found.items()
        if scene in rows and label in columns
    }
    names = max(width_of(gallery.looks[label].title, SMALL) for label in columns)  # they stand upright
    height = (names + 6.0 + CELL * len(rows)) * MM
    figure, axis = pyplot().subplots(figsize=(FULL, height), layout="constrained")
    _heat(axis, grid, (len(rows), len(columns)))
    axis.set_xticks(range(len(columns)), [gallery.looks[label].title for label in columns], rotation=90)
    axis.xaxis.tick_top()
    axis.set_yticks(range(len(rows)), [_name(row) for row in rows])
    axis.tick_params(length=0)
    used = {status for own in grid.values() for status in (own.status, own.absent) if status is not None}
    legend_below(figure, _handles(used, len(grid) < len(rows) * len(columns)))
    scenes = {scene for scene, _ in found}
    fitted = {label for (scene, label), own in found.items() if scene in rows and own.absent is None}
    never = [gallery.looks[label].title for label in gallery.looks if label in fitted - set(columns) - set(REFERENCES)]
    return Picture(figure, _caption(gallery.cells, len(rows), len(scenes), never))


def _caption(cells: Sequence[Result], rows: int, scenes: int, never: Sequence[str]) -> str:
    tried = sum(cell.n - sum(cell.statuses.count(status) for status in NOT_TRIED) for cell in cells)
    failed = sum(cell.statuses.count(status) for cell in cells for status in LETTERS)
    without = f" No fit of these failed there: {'; '.join(never)}." if never else ""
    return (
        f"Fits failed in {rows} of {scenes} kinds of test. In a row, a system with what disturbs its record, the "
        "share (%) of the replicates that were tried and failed, at the noise level and start where it is largest, "
        "with the letter of the most frequent status. White: no failure. Hatched: the method says that it cannot do "
        "this ('unsupported'), or a package is missing; that is no failure of a fit. Kinds of test and methods "
        f"without any failure are left out.{without} Of all {tried} replicates that were tried {failed} failed. A "
        "failure counts as an infinite error in medians, ranks and profiles."
    )


def _name(scene: Scene) -> str:
    """A row's name: the system, and what disturbs it."""
    system, disturbance = scene
    return readable(system) + (f", {readable(disturbance)}" if disturbance else "")


def _heat(axis: Any, grid: Mapping[tuple[int, int], Share], shape: tuple[int, int]) -> None:
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Rectangle

    values = np.full(shape, np.nan)
    for at, own in grid.items():
        values[at] = 100.0 * own.failed if own.failed else np.nan
    colours = ListedColormap(colormaps["OrRd"](np.linspace(0.0, 0.85, 256)))
    axis.imshow(np.ma.masked_invalid(values), cmap=colours, vmin=0, vmax=100, aspect="auto")
    for (row, column), own in grid.items():
        if own.absent is not None:
            hatch = "////" if own.absent is Status.UNSUPPORTED else "...."
            axis.add_patch(Rectangle((column - 0.5, row - 0.5), 1.0, 1.0, fc="0.93", ec="0.45", hatch=hatch, lw=0.0))
        if own.status is not None:
            number = f"{100 * own.failed:.0f}" if own.failed >= 0.01 else "<1"
            style = {"ha": "center", "va": "center", "fontsize": SMALL, "linespacing": 0.95}
            ink = "white" if own.failed > 0.6 else "black"
            axis.text(column, row, f"{number}\n{LETTERS[own.status]}", color=ink, **style)
    axis.set_xticks(np.arange(-0.5, shape[1]), minor=True)
    axis.set_yticks(np.arange(-0.5, shape[0]), minor=True)
    axis.grid(which="minor", color="0.8", lw=0.5)
    axis.tick_params(which="minor", length=0)
    missing = [(r, c) for r in range(shape[0]) for c in range(shape[1]) if (r, c) not in grid]
    if missing:
        axis.plot([c for _, c in missing], [r for r, _ in missing], marker=".", ms=1.5, color="0.6", ls="none")


def _handles(used: set[Status], gaps: bool) -> list[Any]:
    from matplotlib.patches import Patch

    found: list[Any] = [
        entry(ls="none", label=f"{letter}: {status}") for status, letter in LETTERS.items() if status in used
    ]
    if Status.UNSUPPORTED in used:
        found.append(Patch(fc="0.93", ec="0.45", hatch="////", lw=0.0, label="unsupported"))
    if Status.MISSING_DEPENDENCY in used:
        found.append(Patch(fc="0.93", ec="0.45", hatch="....", lw=0.0, label="package missing"))
    if gaps:
        found.append(entry(ls="none", marker=".", ms=1.5, color="0.6", label="not run"))
    return found
