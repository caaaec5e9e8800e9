"""Where searches from several starts end: the objective that each start reached, in order, method by method."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.reporting.figures.gallery import Gallery, Nothing, Picture, methods_only, where
from bench.reporting.figures.style import HALF, MM, Look, handle, legend_below, plain_logarithmic, pyplot
from bench.reporting.frame import Result
from bench.scoring.traces import SAME

OBJECTIVES = "trace_start_objectives"
FLOOR = 1e-4
"""Differences of the objective below this are drawn here: objectives are stored to seven digits."""


def draw_waterfall(gallery: Gallery) -> Picture:
    """The scenario whose searches had most starts: objective above the best over the order of the starts."""
    found = _searches(gallery)
    figure, axis = pyplot().subplots(figsize=(HALF, 58.0 * MM), layout="constrained")
    for i, (cell, ends) in enumerate(found):
        above = np.maximum(ends - ends.min(), FLOOR)
        look = gallery.looks[cell.label]
        axis.plot(np.arange(1, ends.size + 1), above, color=look.colour, lw=1.0, **_nested(look, i, len(found)))
    axis.axhline(SAME, color="0.5", lw=0.8, ls="--")
    axis.annotate(
        "the best end below", (0.01, SAME), xycoords=("axes fraction", "data"), ha="left", va="bottom", color="0.35"
    )
    axis.set(yscale="log", xlabel="start, best first (−)", ylabel="objective above the best (−)")
    axis.xaxis.get_major_locator().set_params(integer=True)
    axis.set_ylim(bottom=FLOOR / 2.0)
    plain_logarithmic(axis.yaxis)
    axis.grid()
    looks = [gallery.looks[cell.label] for cell, _ in found]
    legend_below(figure, [handle(look, **_nested(look, i, len(found))) for i, look in enumerate(looks)])
    counts = "; ".join(
        f"{gallery.looks[cell.label].title} {np.sum(ends <= ends.min() + SAME)} of {ends.size}" for cell, ends in found
    )
    all_same = sum(bool(np.all(ends <= ends.min() + SAME)) for _, ends in found)
    return Picture(
        figure,
        f"Every start ended at the method's best answer in {all_same} of {len(found)} searches. Minus the log "
        f"posterior at the end of each start above that of the best, in order ({where(found[0][0])}; replicate 0), on "
        f"the floor of {FLOOR:g} where they agree. Below the dashed line ({SAME:g}) an end is the best one within "
        f"{np.sqrt(2.0 * SAME):.2f} standard errors. Starts that ended there: {counts}. A start that came to no end "
        "is left out.",
    )


def _nested(look: Look, i: int, n: int) -> dict[str, Any]:
    """A hollow marker, smaller than that of the method before, so that one shows in another where they agree."""
    return {**look.point(4.0 + 5.0 * (n - 1 - i) / max(n, 1), hollow=True), "mew": 1.0}


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
