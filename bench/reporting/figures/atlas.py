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
from bench.reporting.figures.style import entry, legend_below, panels, save_figure

LABELS = {
    "samples": "samples", "cycles": "cycles", "damping_ratio": "damping ratio", "snr_db": "SNR (dB)",
    "phase": "phase (rad)", "bandwidth": "bandwidth over natural frequency", "force_snr_db": "SNR of the force (dB)",
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
    folder = out / "figures"
    folder.mkdir(parents=True, exist_ok=True)
    return [place for own, frame in slices for place in _drawn(own, frame, folder)]


def _drawn(own: Slice, frame: pd.DataFrame, folder: Path) -> list[Path]:
    across, up = own.axes()
    methods = list(dict.fromkeys(frame.method))
    figure, axes = panels(2 + len(methods), 3, 52.0, LABELS[across.name])
    first = frame[frame.method == methods[0]]
    for axis, name in zip(axes, GROUPS, strict=False):
        draw_bound(axis, across, up, first, f"bound_{name}")
        axis.set_title(f"bound on {'k/m' if name == GROUPS[0] else 'c/m'} (%)")
    for axis, method in zip(axes[2:], methods, strict=True):
        mesh = _gross(axis, across, up, frame[frame.method == method])
        axis.set_title(load_method(method).card.title)
    figure.colorbar(mesh, ax=axes, label="share of gross errors in k/m (%)", shrink=0.6, aspect=30)
    legend_below(figure, [
        entry(color=LINE, label=f"within {NEAR:g} times the bound"),
        entry(color="none", marker="s", markerfacecolor=AMBIGUOUS, markersize=7,
              label="above the Nyquist frequency: ambiguous"),
    ])  # fmt: skip
    return save_figure(figure, folder, f"atlas_{own.name}")


def grid(across: Axis, up: Axis, frame: pd.DataFrame, column: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A column over the slice; NaN where a point is not there yet."""
    table = frame.pivot_table(index=up.name, columns=across.name, values=column, dropna=False, observed=False)
    return table.columns.to_numpy(float), table.index.to_numpy(float), table.to_numpy(float)


def draw_bound(axis: Any, across: Axis, up: Axis, frame: pd.DataFrame, column: str) -> None:
    """A bound in grey, by its logarithm, with contours in percent."""
    x, y, z = grid(across, up, frame, column)
    axis.pcolormesh(x, y, np.log10(100.0 * z), cmap=SHADES, vmin=-2.0, vmax=3.0, shading="nearest", rasterized=True)
    lines = axis.contour(x, y, 100.0 * z, levels=LEVELS, colors=LINE, linewidths=0.9)
    axis.clabel(lines, fmt="%g")
    set_scales(axis, across, up)


def _gross(axis: Any, across: Axis, up: Axis, frame: pd.DataFrame) -> Any:
    x, y, z = grid(across, up, frame, f"{GROUPS[0]}_gross")
    mesh = axis.pcolormesh(x, y, 100.0 * z, cmap=SHADES, vmin=0.0, vmax=100.0, shading="nearest", rasterized=True)
    draw_ambiguous(axis, across, up, frame)
    inside = grid(across, up, frame.assign(near=near(frame).astype(float)), "near")[2]
    if np.nanmin(inside) < 0.5 < np.nanmax(inside):
        axis.contour(x, y, inside, levels=[0.5], colors=LINE, linewidths=0.9)
    set_scales(axis, across, up)
    return mesh


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
        label(LABELS[own.name])
