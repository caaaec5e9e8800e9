"""How a loss falls, term by term and training by training: the paper's Figure 6."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bench.reporting.figures.gallery import Gallery, Nothing, Picture, where
from bench.reporting.figures.style import Look, handle, legend_below, panels, plain_logarithmic, wrapped
from bench.reporting.frame import Result
from bench.reporting.labels import beside_paper, title
from bench.reporting.paper import own_method

LOSS, EVALUATIONS, TERM = "trace_loss", "trace_evaluations", "trace_mean_square_"
TITLES = {
    "data": "data", "physics": "equation of motion", "initial": "initial state", "prior": "prior"
}  # fmt: skip


def draw_training(gallery: Gallery) -> Picture:
    """The loss and the mean square of each of its terms over evaluations, one line a method."""
    found = [(cell, gallery.arrays(cell)) for cell in gallery.scene(gallery.main, "known")]
    found = [(cell, arrays) for cell, arrays in found if LOSS in arrays and EVALUATIONS in arrays]
    if not found:
        raise Nothing("no history of a loss is stored")
    names = dict.fromkeys(name for _, arrays in found for name in arrays if name.startswith(TERM))
    order = [f"{TERM}{term}" for term in TITLES]
    terms = [name for name in [*order, *sorted(set(names) - set(order))] if name in names and _any(found, name)]
    figure, axes = panels(1 + len(terms), 3, 42.0, "evaluations of all residuals (−)", sharex=True)
    for axis, name in zip(axes, [LOSS, *terms], strict=True):
        for cell, arrays in found:
            if name in arrays:
                _line(axis, gallery.looks[cell.label], arrays, name)
        term = name.removeprefix(TERM)
        axis.set(xscale="log", yscale="log")
        axis.set_title(
            "whole loss" if name == LOSS else wrapped(TITLES.get(term, term.replace("_", " ")), 48.0), loc="left"
        )
        axis.set_ylabel("loss (−)" if name == LOSS else "mean square (−)")
        plain_logarithmic(axis.yaxis)
        axis.grid()
    legend_below(figure, [handle(gallery.looks[cell.label]) for cell, _ in found])
    last = {gallery.looks[cell.label].title: (a[EVALUATIONS].max(), a[LOSS][-1]) for cell, a in found}
    ends = ", ".join(f"{name} {evaluations:.0f} (loss {loss:.3g})" for name, (evaluations, loss) in last.items())
    soonest, latest = (least(last, key=lambda name: last[name][0]) for least in (min, max))
    lead = f"{soonest} ends its training after {last[soonest][0]:.0f} evaluations"
    lead += f", {latest} after {last[latest][0]:.0f}" if latest != soonest else ""
    same = [label for label in beside_paper(own_method()) if label in {cell.label for cell, _ in found}]
    trainings = (
        f" The {title(same[0])}'s two trainings minimise the same loss of the same network." if len(same) == 2 else ""
    )
    return Picture(
        figure,
        f"{lead}. On the same record ({where(found[0][0])}; replicate 0): the whole loss, each term with the weight "
        "it has at the end (which can lift the curve before), and the mean square of each term, in natural units. "
        f"Evaluations until the end, and the loss there: {ends}.{trainings} A line ends where its training stopped, "
        "which need not be at the minimum. A term that is nil throughout is left out, and a line begins late where a "
        "term is nil at first. The paper's Figure 6 shows the whole loss alone.",
    )


def _any(found: list[tuple[Result, dict[str, np.ndarray]]], name: str) -> bool:
    return any(np.any(arrays[name] > 0) for _, arrays in found if name in arrays)


def _line(axis: object, look: Look, arrays: Mapping[str, np.ndarray], name: str) -> None:
    evaluations, values = arrays[EVALUATIONS], arrays[name]
    order = np.argsort(evaluations, kind="stable")
    values = np.where(values > 0, values, np.nan)[order]
    evaluations = np.maximum(evaluations[order], 1.0)
    every = max(1, len(values) // 8)
    axis.plot(evaluations, values, color=look.colour, lw=1.0, markevery=every, **look.point(3.5))  # type: ignore[attr-defined]
