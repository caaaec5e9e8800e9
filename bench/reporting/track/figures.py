"""The pictures of the measured track: what the siblings of each set say, method by method, and how often they agree."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bench.records.intervals import StatedInterval
from bench.reporting.inline_svg import INK, LINE, MUTED, RC, SERIES, pyplot, row_axis, svg
from bench.reporting.rounding import readable
from bench.reporting.tables.track_table import MAIN, Track, TrackPanel
from bench.systems.sums import GROUPS

BLUE, ORANGE, GREEN, PURPLE = SERIES
WIDTH, ROW = 7.2, 0.3
"""Inches of a picture's width, and of a method's row."""
SPREAD = 0.32
"""Half of a row that its siblings fill."""
OUTER = 8.0
"""What is drawn at most, over the spread of the values: an interval beyond is cut at the edge."""
NOMINAL = 95.0
UNITS = {quantity.name: quantity.unit for quantity in GROUPS}


def forest(panel: TrackPanel) -> str:
    """Values and intervals of every sibling of a set, by method; empty where no method has an answer."""
    names = [name for name in MAIN if any(name in fit.estimates for fit in panel.fits)]
    methods = [m for m in panel.methods if any(name in fit.estimates for fit in panel.own(m) for name in names)]
    if not methods:
        return ""
    plt = pyplot()
    with plt.rc_context(RC):
        figure = plt.figure(figsize=(WIDTH, 1.0 + ROW * len(methods)), layout="constrained")
        axes = figure.subplots(1, len(names), sharey=True, squeeze=False)[0]
        for axis, name in zip(axes, names, strict=True):
            _forest_of(axis, panel, name, methods)
        axes[0].set_yticks(range(len(methods)), methods, fontsize=9)
        axes[0].set_ylim(len(methods) - 0.4, -0.6)
        return svg(figure, f"{panel.name}, {panel.system}: siblings by method", f"{panel.name}-{panel.system}")


def _forest_of(axis: Any, panel: TrackPanel, name: str, methods: Sequence[str]) -> None:
    from matplotlib.ticker import MaxNLocator

    siblings = list(dict.fromkeys(fit.sibling for fit in panel.fits))
    places = np.linspace(-SPREAD, SPREAD, len(siblings)) if len(siblings) > 1 else [0.0]
    told = [
        (row, places[siblings.index(fit.sibling)], fit.estimates[name])
        for row, method in enumerate(methods)
        for fit in panel.own(method)
        if name in fit.estimates
    ]
    known = panel.of.known.get(name)
    low, high = _limits([one for *_, one in told], known.value if known else None)
    for row, place, one in told:
        _interval(axis, row + place, one, low, high)
    if known is not None:
        axis.axvline(known.value, color=GREEN, lw=1.4, ls="--")
    axis.set_xlim(low, high)
    axis.set_title(f"{readable(name)} ({UNITS[name]})")
    axis.xaxis.set_major_locator(MaxNLocator(4))
    axis.ticklabel_format(axis="x", useOffset=False, style="plain" if high >= 1e-3 else "sci")
    row_axis(axis)


def _interval(axis: Any, row: float, one: StatedInterval, low: float, high: float) -> None:
    """Draw the interval of a repeat, over it that assuming white noise, and the value; arrows point outside."""
    both = ((one.low, one.high), (one.white_low, one.white_high))
    wide, own = (np.clip(ends, low, high) for ends in both)
    if np.all(np.isfinite(wide)):
        axis.plot(wide, [row, row], color=BLUE, lw=1.1, solid_capstyle="butt")
    if np.all(np.isfinite(own)):
        axis.plot(own, [row, row], color=ORANGE, lw=2.6, solid_capstyle="butt")
    marker = "o" if low <= one.value <= high else "<" if one.value < low else ">"
    axis.plot(np.clip(one.value, low, high), row, marker, color=INK, ms=2.8, clip_on=False)


def _limits(told: Sequence[StatedInterval], known: float | None) -> tuple[float, float]:
    """Most values whole, and of their intervals no more than :data:`OUTER` times the spread of the values."""
    values = np.array([one.value for one in told] + ([known] if known is not None else []))
    middle = float(np.median(values))
    spread = 1.4826 * float(np.median(np.abs(values - middle))) or 0.01 * abs(middle) or 1.0
    ends = [end for one in told for end in (one.low, one.high) if math.isfinite(end)] or [middle]
    low, high = max(min(ends), middle - OUTER * spread), min(max(ends), middle + OUTER * spread)
    if known is not None:
        low, high = min(low, known), max(high, known)
    margin = 0.05 * (high - low) or 0.1 * abs(high) or 1.0
    return low - margin, high + margin


def coverage(track: Track) -> str:
    """Draw how many intervals of a repeat, and assuming white noise, hold the mean of the other siblings, by set."""
    shares = [(f"{p.name}, {p.system}", _shares(p)) for p in track.panels]
    shown = [(name, found) for name, found in shares if found]
    if not shown:
        return ""
    plt = pyplot()
    with plt.rc_context(RC):
        figure = plt.figure(figsize=(WIDTH, 1.2 + 0.3 * len(shown)), layout="constrained")
        axes = figure.subplots(1, len(MAIN), sharey=True)
        for axis, name in zip(axes, MAIN, strict=True):
            _coverage_of(axis, name, [found for _, found in shown])
        axes[0].set_yticks(range(len(shown)), [name for name, _ in shown], fontsize=9)
        axes[0].set_ylim(len(shown) - 0.5, -0.5)
        figure.supxlabel("intervals that hold the mean of the other siblings (%); dotted: 95", fontsize=10)
        drawn = [axis.get_legend_handles_labels() for axis in axes]
        shown_once = {label: one for handles, labels in drawn for one, label in zip(handles, labels, strict=True)}
        figure.legend(shown_once.values(), shown_once.keys(), loc="outside upper right", ncols=2, fontsize=9)
        return svg(figure, "Coverage of siblings by set", "coverage")


def _coverage_of(axis: Any, name: str, shares: Sequence[Mapping[str, tuple[float, float]]]) -> None:
    """One quantity: a row a set, from the methods' own share to the stated one."""
    axis.axvline(NOMINAL, color=MUTED, lw=0.8, ls=":")
    for row, found in enumerate(shares):
        if name in found:
            stated, own = found[name]
            axis.plot([own, stated], [row, row], color=LINE, lw=2.0)
            axis.plot(own, row, "s", color=ORANGE, ms=5, label="assuming white noise")
            axis.plot(stated, row, "o", color=BLUE, ms=6, label="of a repeat")
    axis.set(xlim=(-4, 104), title=readable(name))
    row_axis(axis)


def _shares(panel: TrackPanel) -> dict[str, tuple[float, float]]:
    """Of all methods together, in percent: stated, white."""
    found = {}
    for name in MAIN:
        every = [panel.agreement(method, name) for method in panel.methods]
        counted = sum(one.counted for one in every)
        if counted:
            stated, white = (sum(one.kinds[kind].covered for one in every) for kind in ("repeat", "white"))
            found[name] = (100.0 * stated / counted, 100.0 * white / counted)
    return found
