"""Error against noise, a panel a method, over the bound: of the groups, and of the displacement (paper's Figure 10)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bench.entrants.reference import REFERENCES
from bench.reporting.figures.gallery import Gallery, Nothing, Picture, best_first, counts
from bench.reporting.figures.style import (
    Look,
    decibels,
    entry,
    legend_below,
    looks,
    panels,
    plain_logarithmic,
    wrapped,
)
from bench.reporting.frame import Result
from bench.reporting.labels import beside_paper, title
from bench.reporting.paper import own_method, printed

GROUPS = {"k_over_m_error_pct": "k/m", "c_over_m_error_pct": "c/m"}
DISPLACEMENT = "rmse"
COLUMNS = 6
NEAR = 1.25
"""A method whose error is at most so many times the bound, in the median over its points, is said to be on it."""
DASHES = ("-", (0, (3.0, 1.2)))
BOUND = {"color": "0.8", "lw": 3.0, "solid_capstyle": "round"}
PAPER = {"marker": "D", "mfc": "none", "linestyle": "none", "ms": 4.0, "mew": 1.1}
PAPER_SYSTEM = {"m": 1.0, "c": 0.4, "k": 8.0}
MILLI = 1000.0


def root_mean_square(cell: Result, metric: str) -> float:
    """From the stored summary: excess times bound; NaN where the method has none."""
    summary = cell.summary.get(metric)
    return summary["excess"] * summary["bound"] if summary else math.nan


def draw_noise(gallery: Gallery) -> Picture:
    """Errors of k/m and c/m over SNR, start known."""
    return _drawn(gallery, list(GROUPS), list(GROUPS.values()), "error (%)", 1.0)


def draw_displacement(gallery: Gallery) -> Picture:
    """Errors of the displacement over SNR, start known, and what the paper prints of its own method."""
    return _drawn(gallery, [DISPLACEMENT], ["displacement"], "error (mm)", MILLI)


def _drawn(gallery: Gallery, metrics: Sequence[str], names: Sequence[str], unit: str, factor: float) -> Picture:
    started = [cell for cell in gallery.main if cell.initial_state == "known"] or gallery.main
    found = [cell for cell in started if cell.label != "prior"]
    metrics = [m for m in metrics if any(math.isfinite(root_mean_square(c, m)) for c in found)]
    lines = {label: own for label in gallery.looks if (own := _lines(found, label, metrics, factor))}
    if not lines:
        raise Nothing("no method with an error and a bound is stored")
    excesses = {label: _excesses(found, label, metrics) for label in lines}
    order = best_first(excesses)
    bounds = [_bounds(found, metric, factor) for metric in metrics]
    figure, axes = panels(len(order), COLUMNS, 23.0, "SNR (dB)", sharex=True, sharey=True)
    for axis, label in zip(axes, order, strict=True):
        _panel(axis, gallery.looks[label], lines[label], bounds)
    _scales(axes, [*bounds, *(line for own in lines.values() for line in own)])
    figure.supylabel(unit)
    paper = _paper(axes, order, found) if metrics == [DISPLACEMENT] else ""
    legend_below(figure, _handles(names if len(metrics) > 1 else [], paper))
    middles = [float(np.median(own)) for label, own in excesses.items() if label not in REFERENCES and own]
    on = sum(middle <= NEAR for middle in middles)
    return Picture(figure, _caption(found, names, on, len(middles), paper))


def _caption(found: Sequence[Result], names: Sequence[str], on: int, total: int, paper: str) -> str:
    styles = f" Filled markers: {names[0]}; hollow ones: {names[1]}." if len(names) > 1 else ""
    theirs = f" Diamonds: {paper} as the paper prints it (its Table 5, Figure 10)." if paper else ""
    return (
        f"{on} of {total} methods are on the bound in {' and '.join(names)}. Each panel is a method "
        f"({found[0].system}, initial state {found[0].initial_state}; {counts(found)} replicates a point): root mean "
        f"square error over the replicates, failures left out; the least noise is on the left.{styles} The broad grey "
        "line is the Cramér-Rao bound, the least error of an unbiased method; a biased one can be below it where the "
        f"noise is large. A method counts as on it whose error is at most {NEAR:g} times the bound in the median over "
        "its noise levels. A line that runs level has an error of its own that no better sensor removes. Panels in "
        f"order of the median excess over the bound, to a tenth of its logarithm.{theirs}"
    )


Line = Mapping[float, float]
"""By SNR (dB), an error."""


def _lines(found: Sequence[Result], label: str, metrics: Sequence[str], factor: float) -> list[Line]:
    """One line a metric of a method; none where it has no error at all."""
    own = [c for c in found if c.label == label]
    lines: list[Line] = [
        {c.snr_db: factor * v for c in own if (v := root_mean_square(c, metric)) > 0} for metric in metrics
    ]
    return lines if any(lines) else []


def _excesses(found: Sequence[Result], label: str, metrics: Sequence[str]) -> list[float]:
    own = [c.summary.get(m, {}).get("excess", math.nan) for c in found if c.label == label for m in metrics]
    return [excess for excess in own if math.isfinite(excess)]


def _bounds(found: Sequence[Result], metric: str, factor: float) -> Line:
    return {c.snr_db: factor * c.bound(metric) for c in found if math.isfinite(c.bound(metric))}


def _panel(axis: Any, look: Look, lines: Sequence[Line], bounds: Sequence[Line]) -> None:
    for bound in bounds:
        snrs = sorted(bound)
        axis.plot(snrs, [bound[snr] for snr in snrs], **BOUND, marker="_" if len(snrs) == 1 else None, ms=14, zorder=1)
    for i, line in enumerate(lines):
        point = look.point(3.6, hollow=i > 0) | ({"mfc": "white"} if i > 0 else {})
        snrs = sorted(line)
        axis.plot(snrs, [line[snr] for snr in snrs], color=look.colour, lw=0.9, ls=DASHES[i], **point, zorder=3)
    axis.set_title(wrapped(look.title, 26.0), loc="left")
    axis.grid()


def _scales(axes: Sequence[Any], lines: Sequence[Line]) -> None:
    """The same scales in all panels."""
    from matplotlib.ticker import LogLocator

    values = [value for line in lines for value in line.values()]
    axes[0].set(yscale="log", ylim=(0.6 * min(values), 1.7 * max(values)))
    plain_logarithmic(axes[0].yaxis)
    axes[0].yaxis.set_major_locator(LogLocator(numticks=9))
    for axis in axes:
        label = axis.get_xlabel()
        decibels(axis, sorted({snr for line in lines for snr in line}))
        axis.set_xlabel(label)


def _paper(axes: Sequence[Any], order: Sequence[str], found: Sequence[Result]) -> str:
    """Draw what the paper prints beside its own method; its name, where this is the system of the paper's Table 5."""
    if found[0].parameters != PAPER_SYSTEM or found[0].kind != "sdof":
        return ""
    theirs = [label for label in beside_paper(own_method()) if label in order]
    if not theirs:
        return ""
    points = [(p.snr_db, MILLI * p.value) for p in printed() if p.table == 5 and p.metric == DISPLACEMENT]
    for label in theirs:
        axes[order.index(label)].plot(*zip(*points, strict=True), **PAPER, color=looks([theirs[0]])[theirs[0]].colour)
    return title(theirs[0])


def _handles(names: Sequence[str], paper: str) -> list[Any]:
    point = {"marker": "o", "ms": 3.6, "mew": 0.8, "color": "0.3", "lw": 0.9}
    faces = zip(names, DASHES, ("0.3", "white"), strict=False)
    found = [entry(**point, mfc=face, ls=dashes, label=name) for name, dashes, face in faces]
    found.append(entry(**BOUND, label="Cramér-Rao bound"))
    return [*found, *([entry(**PAPER, color="0.3", label=f"{paper}, as the paper prints it")] if paper else [])]
