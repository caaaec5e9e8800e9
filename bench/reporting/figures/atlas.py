"""Maps of the atlas: on each slice the bound, where methods leave it, and which are near it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bench.atlas.axes import Axis
from bench.atlas.design import Slice
from bench.atlas.point import GROUPS
from bench.entrants.registry import load_method
from bench.reporting.atlas import NEAR, near
from bench.reporting.figures.style import entry, legend_below, panels, plain_logarithmic, save_figure

LABELS = {
    "samples": "samples (−)", "cycles": "cycles (−)", "damping_ratio": "damping ratio (−)", "snr_db": "SNR (dB)",
    "phase": "phase (rad)", "bandwidth": "bandwidth / natural frequency (−)", "force_snr_db": "SNR of the force (dB)",
}  # fmt: skip
LEVELS = (0.1, 1.0, 10.0, 100.0)
"""Contours of the bound, %."""
SHADES = "Greys"
LINE = "#AA3377"
AMBIGUOUS = "#88CCEE"
SHORT = 20.0
"""Of a logarithmic axis, highest over lowest, below which powers of two are marked instead of powers of ten."""


def draw_atlas(slices: Sequence[tuple[Slice, pd.DataFrame]], out: Path) -> list[Path]:
    """A picture a slice; returns the files."""
    return [place for own, frame in slices for place in _drawn(own, frame, out / "figures")]


def _drawn(own: Slice, frame: pd.DataFrame, folder: Path) -> list[Path]:
    across, up = own.axes()
    methods = list(dict.fromkeys(frame.method))
    columns = min((3, 4), key=lambda columns: -(2 + len(methods)) % columns)  # that leaves fewest places empty
    figure, axes = panels(2 + len(methods), columns, 156.0 / columns, LABELS[across.name])
    first = frame[frame.method == methods[0]]
    for axis, name in zip(axes, GROUPS, strict=False):
        draw_bound(axis, across, up, first, f"bound_{name}")
        axis.set_title(f"bound on {'k/m' if name == GROUPS[0] else 'c/m'} (%)", loc="left")
    for axis, method in zip(axes[2:], methods, strict=True):
        mesh = _gross(axis, across, up, frame[frame.method == method])
        axis.set_title(load_method(method).card.title, loc="left")
    figure.colorbar(mesh, ax=axes, label="share of gross errors in k/m (%)", shrink=0.6, aspect=30)
    ambiguous = bool(frame.aliased.any())
    legend_below(figure, [
        entry(color=LINE, lw=1.0, label=f"around where it is within {NEAR:g} times the bound"),
        *([ambiguous_entry()] if ambiguous else []),
    ])  # fmt: skip
    return save_figure(
        figure, folder, f"atlas_{own.name}", _caption(frame, methods, LABELS[across.name], LABELS[up.name], ambiguous)
    )


def _caption(frame: pd.DataFrame, methods: Sequence[str], across: str, up: str, ambiguous: bool) -> str:
    told = frame[~frame.aliased.astype(bool)]
    shares = told.groupby("method", sort=False).apply(lambda own: 100.0 * float(near(own).mean()), include_groups=False)
    best = str(shares.idxmax())
    blue = " Blue: above the Nyquist frequency, where several frequencies fit the samples equally." if ambiguous else ""
    return (
        f"{load_method(best).card.title} is near the bound on the largest part of this map, {shares[best]:.0f} %. "
        f"Across: {across}; up: {up}. The first two panels: the Cramér-Rao bound on k/m and on c/m, light is low, "
        "with lines at whole powers of ten. Then a panel a method: the darker, the more of its estimates of k/m are "
        f"grossly wrong; the line goes around where its error of k/m is within {NEAR:g} times the bound, as the "
        f"majority of each point and its eight neighbours has it, since a point has few data sets.{blue}"
    )


def ambiguous_entry() -> Any:
    """A legend's entry for what is above the Nyquist frequency."""
    label = "above the Nyquist frequency: ambiguous"
    return entry(color="none", marker="s", markerfacecolor=AMBIGUOUS, markersize=7, label=label)


def grid(across: Axis, up: Axis, frame: pd.DataFrame, column: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A column over the slice; NaN where a point is not there yet."""
    table = frame.pivot_table(index=up.name, columns=across.name, values=column, dropna=False, observed=False)
    return table.columns.to_numpy(float), table.index.to_numpy(float), table.to_numpy(float)


def draw_bound(axis: Any, across: Axis, up: Axis, frame: pd.DataFrame, column: str) -> None:
    """A bound in grey, by its logarithm, with contours in percent."""
    x, y, z = grid(across, up, frame, column)
    axis.pcolormesh(x, y, np.log10(100.0 * z), cmap=SHADES, vmin=-2.0, vmax=3.0, shading="nearest", rasterized=True)
    if min(z.shape) > 1:  # the first blocks of a slice are not yet two rows
        lines = axis.contour(x, y, 100.0 * z, levels=LEVELS, colors=LINE, linewidths=0.9)
        axis.clabel(lines, fmt="%g", inline_spacing=1)
    set_scales(axis, across, up)


def _gross(axis: Any, across: Axis, up: Axis, frame: pd.DataFrame) -> Any:
    x, y, z = grid(across, up, frame, f"{GROUPS[0]}_gross")
    mesh = axis.pcolormesh(x, y, 100.0 * z, cmap=SHADES, vmin=0.0, vmax=100.0, shading="nearest", rasterized=True)
    draw_ambiguous(axis, across, up, frame)
    inside = grid(across, up, frame.assign(near=near(frame).astype(float)), "near")[2]
    inside = majority(inside)
    if min(inside.shape) > 1 and np.nanmin(inside) < 0.5 < np.nanmax(inside):
        axis.contour(x, y, inside, levels=[0.5], colors=LINE, linewidths=0.9)
    set_scales(axis, across, up)
    return mesh


def majority(inside: np.ndarray) -> np.ndarray:
    """What most of each point and its eight neighbours say, of a map of ones and zeros; at an edge it counts twice."""
    from scipy.ndimage import median_filter

    return np.asarray(median_filter(np.nan_to_num(inside), 3, mode="nearest"))


def draw_ambiguous(axis: Any, across: Axis, up: Axis, frame: pd.DataFrame) -> None:
    """The cells above the Nyquist frequency, over what is there."""
    x, y, z = grid(across, up, frame.assign(own=frame.aliased.astype(float)), "own")
    axis.pcolormesh(x, y, np.where(z > 0, 1.0, np.nan), cmap=one_colour(AMBIGUOUS), shading="nearest", rasterized=True)


def one_colour(name: str) -> Any:
    """A map of one colour."""
    from matplotlib.colors import ListedColormap

    return ListedColormap([name])


def set_scales(axis: Any, across: Axis, up: Axis) -> None:
    """Scales and labels of the two axes of a slice."""
    sides = (across, axis.xaxis, axis.set_xscale, axis.set_xlabel), (up, axis.yaxis, axis.set_yscale, axis.set_ylabel)
    for own, side, scale, label in sides:
        if own.spacing == "logarithmic":
            scale("log")
            if own.high < SHORT * own.low:
                ticks = own.low * 2.0 ** np.arange(math.floor(math.log2(own.high / own.low)) + 1)
                side.set_ticks(ticks, [f"{tick:g}" for tick in ticks])
                side.set_ticks([], minor=True)
            else:
                plain_logarithmic(side)
        label(LABELS[own.name])
