"""Error against noise for every method, with the bound: the paper's Figure 10."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bench.reporting.figures.gallery import Gallery, Nothing, Picture, counts
from bench.reporting.figures.style import (
    FULL,
    MM,
    Look,
    decibels,
    entry,
    handle,
    legend_below,
    looks,
    plain_logarithmic,
    pyplot,
)
from bench.reporting.frame import Result
from bench.reporting.labels import beside_paper, title
from bench.reporting.paper import own_method, printed

PANELS = (
    ("k_over_m_error_pct", "error of k/m (%)"),
    ("c_over_m_error_pct", "error of c/m (%)"),
    ("rmse", "displacement error (m)"),
)
ON_BOUND, MOSTLY = 1.25, 0.75
"""A method whose errors are mostly below so many times the bound lies on it: its markers are hollow, one in another."""
PAPER = {"marker": "D", "mfc": "none", "linestyle": "none", "ms": 5.0, "mew": 1.1}
PAPER_SYSTEM = {"m": 1.0, "c": 0.4, "k": 8.0}


def root_mean_square(cell: Result, metric: str) -> float:
    """From the stored summary: excess times bound; NaN where the method has none."""
    summary = cell.summary.get(metric)
    return summary["excess"] * summary["bound"] if summary else math.nan


def draw_noise(gallery: Gallery) -> Picture:
    """One panel a metric, one line a method, over SNR; start known."""
    started = [cell for cell in gallery.main if cell.initial_state == "known"] or gallery.main
    found = [cell for cell in started if cell.label != "prior"]
    metrics = [(m, label) for m, label in PANELS if any(math.isfinite(root_mean_square(c, m)) for c in found)]
    if not metrics:
        raise Nothing("no method with an error and a bound is stored")
    figure, axes = pyplot().subplots(
        1, len(metrics), figsize=(FULL * (0.4 + 0.2 * len(metrics)), 70.0 * MM), layout="constrained", squeeze=False
    )
    sizes = _sizes(found)
    drawn: dict[str, Look] = {}
    for axis, (metric, label) in zip(axes[0], metrics, strict=True):
        drawn |= _panel(axis, gallery, found, metric, sizes)
        axis.set_title(label, loc="left")
    handles = [_region(), *(_entry(look, sizes) for label, look in gallery.looks.items() if label in drawn)]
    if metrics[-1][0] == "rmse" and _papers(found):
        theirs = beside_paper(own_method())[0]
        style = {**PAPER, "color": looks([theirs])[theirs].colour}
        axes[0][-1].plot(*_paper_points(), **style, zorder=20)
        handles.append(entry(**style, label=f"the paper's {title(theirs)}"))
    legend_below(figure, handles)
    return Picture(figure, _caption(found, sizes, len(handles) - 1 > len(drawn)))


def _caption(found: Sequence[Result], sizes: Mapping[str, float], paper: bool) -> str:
    hollow = f" {len(sizes)} methods lie on each other there: hollow markers, one in another." if sizes else ""
    return (
        f"Error against noise for every method ({found[0].system}, initial state {found[0].initial_state}; "
        f"{counts(found)} replicates a point): root mean square error over the replicates, failures left out. The line "
        "is the Cramér-Rao bound, and below it, in grey, no unbiased method can be; a biased one can, where the noise "
        f"is large.{hollow} A line that runs level has an error of its own that no better sensor "
        "removes." + (" Orange diamonds: the paper's own PINN (its Table 5, Figure 10)." if paper else "")
    )


def _papers(found: Sequence[Result]) -> bool:
    """Whether this is the system of the paper's Table 5."""
    return found[0].parameters == PAPER_SYSTEM and found[0].kind == "sdof"


def _paper_points() -> tuple[Any, ...]:
    points = [(p.snr_db, p.value) for p in printed() if p.table == 5 and p.metric == "rmse"]
    return tuple(zip(*points, strict=True))


def _sizes(found: Sequence[Result]) -> dict[str, float]:
    """Marker sizes of the methods that lie on the bound, from large to small in the order of methods."""
    near: dict[str, list[bool]] = {}
    for cell in found:
        excess = [cell.summary.get(metric, {}).get("excess", math.nan) for metric, _ in PANELS]
        near.setdefault(cell.label, []).extend(e < ON_BOUND for e in excess if math.isfinite(e))
    on = [label for label, own in near.items() if own and np.mean(own) >= MOSTLY]
    return {label: 3.0 + 7.5 * (len(on) - i) / len(on) for i, label in enumerate(on)} if len(on) > 1 else {}


def _panel(
    axis: Any, gallery: Gallery, found: Sequence[Result], metric: str, sizes: Mapping[str, float]
) -> dict[str, Look]:
    points: dict[str, dict[float, float]] = {}
    for cell in found:
        value = root_mean_square(cell, metric)
        if math.isfinite(value) and value > 0:
            points.setdefault(cell.label, {})[cell.snr_db] = value
    bounds = {cell.snr_db: cell.bound(metric) for cell in found if math.isfinite(cell.bound(metric))}
    snrs = sorted(bounds)
    line = [bounds[snr] for snr in snrs]
    axis.fill_between(snrs, line, 1e-15, color="0.9", lw=0)
    axis.plot(snrs, line, color="black", lw=1.4, marker="_" if len(snrs) == 1 else None, ms=14)
    for i, (label, own) in enumerate(points.items()):
        look, drawn = gallery.looks[label], sorted(own)
        point = look.point(sizes.get(label, 4.0), hollow=label in sizes)
        axis.plot(drawn, [own[s] for s in drawn], color=look.colour, lw=0.8, **point, zorder=3 + 0.1 * i)
    values = [*line, *(v for own in points.values() for v in own.values())]
    axis.set(yscale="log", ylim=(0.5 * min(values), 2.0 * max(values)))
    plain_logarithmic(axis.yaxis)
    decibels(axis, snrs)
    axis.grid()
    return {label: gallery.looks[label] for label in points}


def _region() -> Any:

    return entry(color="black", lw=1.4, label="Cramér-Rao bound")


def _entry(look: Look, sizes: Mapping[str, float]) -> Any:
    size = min(sizes.get(look.label, 4.0), 7.0)
    return handle(look, **{**look.point(size, hollow=look.label in sizes), "lw": 0.8})
