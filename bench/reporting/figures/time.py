"""Accuracy against time: what a fit takes, and how far it is from the bound, a row a method."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bench.contract.estimate import Status
from bench.reporting.figures.gallery import Gallery, Nothing, Picture, methods_only, where
from bench.reporting.figures.style import Look, entry, legend_below, plain_logarithmic, rows_of_methods
from bench.reporting.frame import Result

METRICS = (("k_over_m_error_pct", "k/m"), ("rmse", "displacement"))
STARTS = ("known", "unknown")
NEAR = 1.25
"""A method whose error is at most so many times the bound, whichever the start, is in colour."""
FAR = "0.6"
APART = 0.17
"""Half of how far the two starts of a row stand apart, in rows."""
Point = tuple[float, float, float]
"""Median and longest time (s) of a fit, and excess."""


def draw_time(gallery: Gallery) -> Picture:
    """Time on the left, excess on the right, fastest first."""
    usual = gallery.scene(gallery.main, "known")[0].snr_db
    cells = [c for c in methods_only(gallery.main) if c.snr_db == usual]
    choices = [(name, _points(cells, metric)) for metric, name in METRICS]
    name, points = next(((name, own) for name, own in choices if own), ("", {}))
    if not points:
        raise Nothing("no method with a time and an excess is stored")
    order = sorted(points, key=lambda label: max(median for median, _, _ in points[label].values()))
    near = [label for label in order if max(excess for *_, excess in points[label].values()) <= NEAR]
    starts = [told for told in STARTS if any(told in own for own in points.values())]
    figure, axes = rows_of_methods([gallery.looks[label] for label in order], 2)
    for row, label in enumerate(order):
        _row(axes, row, gallery.looks[label], points[label], label in near)
    axes[1].axvline(1.0, color="black", lw=0.9, zorder=1)
    for axis, text in zip(axes, ("processor time of a fit (s)", f"error of {name} / bound (−)"), strict=True):
        axis.set(xscale="log", xlabel=text)
        plain_logarithmic(axis.xaxis)
    legend_below(figure, _handles(starts if len(starts) > 1 else []))
    scene = where(cells[0]).rpartition(", initial state")[0]
    fastest = gallery.looks[near[0]].title if near else ""
    return Picture(figure, _caption(scene, name, starts, fastest))


def _caption(scene: str, name: str, starts: Sequence[str], fastest: str) -> str:
    lead = f"{fastest} is the fastest method near the bound" if fastest else "No method is near the bound"
    two = " Filled: initial state known; hollow: unknown." if len(starts) > 1 else f" Initial state {starts[0]}."
    return (
        f"{lead}. Left: processor time of a fit, fastest first ({scene}); the marker is the median fit, everything "
        "loaded, and the line goes to the slowest, often the first of a process, which loads and builds what the "
        f"method needs. Right: root mean square error of {name} over its Cramér-Rao bound; left is better, 1 is the "
        f"best that the data allow.{two} In colour: at most {NEAR:g} times the bound, whichever the start; the others "
        "are grey."
    )


def _points(cells: Sequence[Result], metric: str) -> dict[str, dict[str, Point]]:
    """By method, then by start; a method with none is left out."""
    points: dict[str, dict[str, Point]] = {}
    for cell in cells:
        if cell.initial_state in STARTS and (own := _point(cell, metric)):
            points.setdefault(cell.label, {})[cell.initial_state] = own
    return points


def _point(cell: Result, metric: str) -> Point | None:
    """None where the cell has no time or no excess."""
    ok = np.array([status is Status.OK for status in cell.statuses])
    seconds = cell.cpu_s[ok & np.isfinite(cell.cpu_s) & (cell.cpu_s > 0)]
    excess = cell.summary.get(metric, {}).get("excess", math.nan)
    if not seconds.size or not math.isfinite(excess) or excess <= 0:
        return None
    return float(np.sort(seconds)[seconds.size // 2]), float(seconds.max()), excess


def _row(axes: Sequence[Any], row: int, look: Look, points: Mapping[str, Point], near: bool) -> None:
    colour = look.colour if near else FAR
    for told, (median, longest, excess) in points.items():
        hollow = told == STARTS[1]
        at = row + ((APART if hollow else -APART) if len(points) > 1 else 0.0)
        style = {
            **look.point(3.6),
            "mec": colour,
            "mfc": "white" if hollow else colour,
            "mew": 0.8,
            "linestyle": "none",
        }
        axes[0].plot([median, longest], [at, at], color=colour, lw=0.8, zorder=2)
        axes[0].plot(median, at, **style, zorder=3)
        axes[1].plot(excess, at, **style, zorder=3)


def _handles(starts: Sequence[str]) -> list[Any]:
    point = {"marker": "o", "ms": 3.6, "mew": 0.8, "color": "0.3", "linestyle": "none"}
    faces = zip(starts, ("0.3", "white"), strict=False)
    found = [entry(**point, mfc=face, label=f"initial state {told}") for told, face in faces]
    return [*found, entry(color="0.3", lw=0.8, label="to the slowest fit")]
