"""Accuracy against time: what a fit takes, and how far it is from the bound."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from bench.contract.estimate import Status
from bench.reporting.figures.gallery import Gallery, Nothing, Picture, methods_only, where
from bench.reporting.figures.style import FULL, MM, Look, handle, legend_below, plain_logarithmic, pyplot
from bench.reporting.frame import Result

METRICS = (("k_over_m_error_pct", "k/m"), ("rmse", "displacement"))


def draw_time(gallery: Gallery) -> Picture:
    """Excess against processor time, one panel a reading of the start."""
    usual = gallery.scene(gallery.main, "known")[0].snr_db
    cells = [c for c in methods_only(gallery.main) if c.snr_db == usual]
    found = {told: [c for c in cells if c.initial_state == told] for told in ("known", "unknown")}
    choices = [(name, _points(found, metric)) for metric, name in METRICS]
    name, points = next(((name, own) for name, own in choices if own), ("", {}))
    if not points:
        raise Nothing("no method with a time and an excess is stored")
    figure, axes = pyplot().subplots(
        1, len(points), figsize=(FULL, 68.0 * MM), layout="constrained", sharey=True, squeeze=False
    )
    drawn: dict[str, Look] = {}
    for axis, (told, own) in zip(axes[0], points.items(), strict=True):
        _panel(axis, gallery, own)
        axis.set_title(f"initial state {told}", loc="left")
        drawn |= {label: gallery.looks[label] for label in own}
    axes[0][0].set_ylabel(f"error of {name} / bound (−)")
    legend_below(figure, [handle(look, lw=0) for label, look in gallery.looks.items() if label in drawn])
    scene = where(next(c for c in cells)).rpartition(", initial state")[0]
    return Picture(
        figure,
        f"Accuracy against time ({scene}): root mean square error of {name} over its Cramér-Rao bound, and processor "
        "time of a fit. Marker: the median fit, everything loaded. Line to the right: the slowest, often the first of "
        "a process, which loads and builds what the method needs. Left is faster, low is better, 1 is the best that "
        "the data allow.",
    )


def _points(found: dict[str, list[Result]], metric: str) -> dict[str, dict[str, tuple[float, float, float]]]:
    """By start, then by method; a start with no method is left out."""
    points = {told: {c.label: p for c in own if (p := _point(c, metric))} for told, own in found.items()}
    return {told: own for told, own in points.items() if own}


def _point(cell: Result, metric: str) -> tuple[float, float, float] | None:
    """Median and longest time (s) of a fit, and excess; None where the cell has none of these."""
    ok = np.array([status is Status.OK for status in cell.statuses])
    seconds = cell.cpu_s[ok & np.isfinite(cell.cpu_s) & (cell.cpu_s > 0)]
    excess = cell.summary.get(metric, {}).get("excess", math.nan)
    if not seconds.size or not math.isfinite(excess) or excess <= 0:
        return None
    return float(np.sort(seconds)[seconds.size // 2]), float(seconds.max()), excess


def _panel(axis: Any, gallery: Gallery, points: dict[str, tuple[float, float, float]]) -> None:
    axis.axhline(1.0, color="black", lw=1.0, zorder=1)
    for label, (median, longest, excess) in points.items():
        look = gallery.looks[label]
        axis.plot([median, longest], [excess, excess], color=look.colour, lw=0.7, alpha=0.6, zorder=2)
        axis.plot(median, excess, **look.point(6.0), ls="none", zorder=3)
    axis.set(xscale="log", yscale="log", xlabel="processor time of a fit (s)")
    plain_logarithmic(axis.yaxis)
    axis.grid()
