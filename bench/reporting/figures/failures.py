"""What failed where: the share of failed replicates of every method in every scenario, by status."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.contract.estimate import Status
from bench.reporting.figures.gallery import Gallery, Nothing, Picture, where
from bench.reporting.figures.style import FULL, MM, SMALL, entry, legend_below, pyplot, width_of
from bench.reporting.frame import Result

LETTERS = {
    Status.DIVERGED: "d", Status.NONFINITE: "n", Status.TIMEOUT: "t", Status.KILLED: "k", Status.OOM: "o",
    Status.CRASHED: "c", Status.INVALID: "i",
}  # fmt: skip
NOT_TRIED = (Status.UNSUPPORTED, Status.MISSING_DEPENDENCY)
"""Not failures of a fit: the method says that it cannot, or its package is not there."""
MANY = 18
"""Methods from which on a number and its letter stand one above the other."""
MOST = 60
"""Scenarios shown at most: those with most failures."""


def shares(cell: Result) -> tuple[float, Status | None, Status | None]:
    """Share of replicates that were tried and failed, their most frequent status, and why it was not tried, if so."""
    counted = Counter(cell.statuses)
    absent = max((s for s in NOT_TRIED if counted[s]), key=lambda s: counted[s], default=None)
    failed = {status: counted[status] for status in LETTERS if counted[status]}
    total = sum(failed.values()) / cell.n if cell.n else 0.0
    return total, max(failed, key=lambda s: failed[s], default=None), absent


def draw_failures(gallery: Gallery) -> Picture:
    """A heat map, a row a scenario and a column a method."""
    scenes: dict[tuple[Any, ...], list[Result]] = {}
    for cell in gallery.cells:
        scenes.setdefault((cell.system, cell.disturbance, -cell.snr_db, cell.initial_state, cell.series), []).append(
            cell
        )
    bad = {key: sum(c.n - c.n_ok for c in own) for key, own in scenes.items()}
    keys = sorted(key for key in scenes if bad[key])
    if not keys:
        raise Nothing("no replicate of any cell failed")
    if len(keys) > MOST:
        keys = sorted(sorted(keys, key=lambda key: -bad[key])[:MOST])
    labels = [label for label in gallery.looks if any(c.label == label for key in keys for c in scenes[key])]
    grid: dict[tuple[int, int], Result] = {
        (row, labels.index(c.label)): c for row, key in enumerate(keys) for c in scenes[key]
    }
    many = len(labels) > MANY
    names = max(width_of(gallery.looks[label].title, SMALL) for label in labels)  # they stand upright
    height = (names + 6.0 + (7.0 if many else 4.6) * len(keys)) * MM
    figure, axis = pyplot().subplots(figsize=(FULL, height), layout="constrained")
    _heat(axis, grid, (len(keys), len(labels)), "\n" if many else "")
    axis.set_xticks(range(len(labels)), [gallery.looks[label].title for label in labels], rotation=90)
    axis.set_yticks(range(len(keys)), _names([scenes[key][0] for key in keys]))
    axis.tick_params(length=0)
    used = {status for cell in grid.values() for status in shares(cell)[1:] if status is not None}
    legend_below(figure, _handles(used, len(grid) < len(keys) * len(labels)))
    fine = len(scenes) - len(keys)
    return Picture(figure, _caption(fine, sum(c.n - c.n_ok for c in gallery.cells), sum(c.n for c in gallery.cells)))


def _caption(left_out: int, failed: int, total: int) -> str:
    return (
        f"Where methods fail: the share (%) of the replicates of each method and scenario that were tried and failed, "
        "with the letter of the most frequent status. Hatched: the method says that it cannot do this ('unsupported'), "
        f"or a package is missing; that is no failure of a fit. White: no failure. {left_out} scenarios in which "
        f"nothing failed (or less than in those shown) are left out. In all {failed} of {total} stored replicates are "
        "not ok. A failure counts as an infinite error in medians, ranks and profiles."
    )


def _heat(axis: Any, grid: dict[tuple[int, int], Result], shape: tuple[int, int], between: str) -> None:
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Rectangle

    values = np.full(shape, np.nan)
    for at, cell in grid.items():
        values[at] = 100.0 * shares(cell)[0]
    colours = ListedColormap(colormaps["OrRd"](np.linspace(0.0, 0.85, 256)))
    axis.imshow(
        np.ma.masked_invalid(np.where(values > 0, values, np.nan)), cmap=colours, vmin=0, vmax=100, aspect="auto"
    )
    for (row, column), cell in grid.items():
        total, status, absent = shares(cell)
        if absent is not None:
            hatch = "////" if absent is Status.UNSUPPORTED else "...."
            axis.add_patch(Rectangle((column - 0.5, row - 0.5), 1.0, 1.0, fc="0.93", ec="0.45", hatch=hatch, lw=0.0))
        if status is not None:
            number = f"{100 * total:.0f}" if total >= 0.01 else "<1"
            text = f"{number}{between}{LETTERS[status]}"
            style = {"ha": "center", "va": "center", "fontsize": 7 if len(text) < 4 else 5.5}  # a narrow cell
            axis.text(column, row, text, color="white" if total > 0.6 else "black", **style)
    axis.set_xticks(np.arange(-0.5, shape[1]), minor=True)
    axis.set_yticks(np.arange(-0.5, shape[0]), minor=True)
    axis.grid(which="minor", color="0.8", lw=0.5)
    axis.tick_params(which="minor", length=0)
    missing = [(r, c) for r in range(shape[0]) for c in range(shape[1]) if (r, c) not in grid]
    if missing:
        axis.plot([c for _, c in missing], [r for r, _ in missing], marker=".", ms=1.5, color="0.6", ls="none")


def _names(cells: Sequence[Result]) -> list[str]:
    """A name for each row; with what tells rows of one name apart."""
    names = [where(c).replace("initial state", "start") for c in cells]
    for name, several in Counter(names).items():
        if several > 1:
            own = [i for i, other in enumerate(names) if other == name]
            traits = zip(*(_traits(cells[i]) for i in own), strict=True)
            for varied in (column for column in traits if len(set(column)) > 1):
                for i, text in zip(own, varied, strict=True):
                    names[i] += f", {text}"
    counted, numbers = Counter(names), Counter[str]()
    for i, name in enumerate(names):
        if counted[name] > 1:
            numbers[name] += 1
            names[i] = f"{name} ({numbers[name]})"
    return names


def _traits(cell: Result) -> tuple[str, ...]:
    """What may tell scenarios of one name apart."""
    prior = f"mass known to {100 * cell.prior['mass']:g} %" if cell.prior else "no prior"
    return f"{cell.duration:g} s", f"{cell.samples} samples", prior, f"seed {cell.seed}"


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
        found.append(entry(ls="none", marker=".", ms=1.5, color="0.6", label="not stored"))
    return found
