"""Where searches from several starts end: the objective that each start reached, in order, method by method."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.reporting.figures.gallery import Gallery, Nothing, Picture, methods_only, where
from bench.reporting.figures.style import FULL, MM, handle, legend_below, plain_logarithmic, pyplot
from bench.reporting.frame import Result
from bench.scoring.search import SAME

OBJECTIVES = "trace_start_objectives"
FLOOR = 1e-4
"""Differences of the objective below this are drawn here: objectives are stored to seven digits."""


def draw_waterfall(gallery: Gallery) -> Picture:
    """The scenario whose searches had most starts: objective above the best over the order of the starts."""
    found = _searches(gallery)
    figure, axis = pyplot().subplots(figsize=(FULL, 75.0 * MM), layout="constrained")
    for cell, ends in found:
        above = np.maximum(ends - ends.min(), FLOOR)
        look = gallery.looks[cell.label]
        axis.plot(np.arange(1, ends.size + 1), above, color=look.colour, lw=1.0, **look.point(4.0))
    axis.axhline(SAME, color="0.5", lw=0.8, ls="--")
    axis.annotate(
        "same end below", (0.01, SAME), xycoords=("axes fraction", "data"), ha="left", va="bottom", color="0.35"
    )
    axis.set(yscale="log", xlabel="start, best first (−)", ylabel="objective above the best (−)")
    axis.xaxis.get_major_locator().set_params(integer=True)
    axis.set_ylim(bottom=FLOOR / 2.0)
    plain_logarithmic(axis.yaxis)
    axis.grid()
    legend_below(figure, [handle(gallery.looks[cell.label]) for cell, _ in found])
    counts = ", ".join(
        f"{gallery.looks[cell.label].title} {np.sum(ends <= ends.min() + SAME)} of {ends.size}" for cell, ends in found
    )
    return Picture(
        figure,
        f"Where searches from several starts end ({where(found[0][0])}; replicate 0): minus the log posterior at each "
        f"end above that of the method's best, on the floor of {FLOOR:g} where they agree. Below the dashed line "
        f"({SAME:g}) an end is the best one within {np.sqrt(2.0 * SAME):.2f} standard errors. Starts that ended there: "
        f"{counts}. A start that came to no end is left out.",
    )


def _searches(gallery: Gallery) -> list[tuple[Result, np.ndarray]]:
    """Cells and the objectives of their starts, least first, of the scenario that has most starts."""
    scenes: dict[tuple[Any, ...], list[tuple[Result, float]]] = {}
    for cell in methods_only(gallery.cells):
        starts = cell.successful("starts")
        if starts.size and starts.max() > 1.0:
            key = cell.series, cell.snr_db, cell.initial_state
            scenes.setdefault(key, []).append((cell, float(starts.mean())))
    for own in sorted(scenes.values(), key=lambda own: (-sum(n for _, n in own), own[0][0].identity)):
        arrays = [(cell, gallery.arrays(cell).get(OBJECTIVES, np.empty(0))) for cell, _ in own]
        kept = [(cell, np.sort(ends)) for cell, ends in arrays if ends.size > 1]
        if kept:
            return kept
    raise Nothing("no search from several starts is stored")
