"""Maps of the atlas by its model: bound, threshold, and the fastest of the methods that are near the bound."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bench.atlas.axes import Axis
from bench.atlas.design import Slice
from bench.atlas.model import FEWEST, AtlasModel, told
from bench.entrants.registry import load_method
from bench.reporting.atlas import NEAR, RARE, point_frame
from bench.reporting.figures.atlas import (
    LABELS,
    LINE,
    ambiguous_entry,
    draw_ambiguous,
    draw_bound,
    grid,
    one_colour,
    set_scales,
)
from bench.reporting.figures.style import entry, legend_below, panels, save_figure

QUANTITY = "k_over_m"
RISKS = (1.0, 10.0, 50.0)
"""Contours of the probability of a wrong basin, %."""
GREYS = ("#E6E6E6", "#D0D0D0", "#BDBDBD", "#9B9B9B", "#777777", "#525252")
EVERY = 3
"""A letter in every n-th cell, each way."""


def draw_regions(slices: Sequence[Slice], atlas: pd.DataFrame, out: Path) -> list[Path]:
    """A picture a slice, from the model of each method with points enough; the files, none without such a method."""
    folder = out / "figures"
    unknown = atlas[~atlas.start_known]
    fastest = unknown.groupby("method").seconds.median().sort_values().index
    models = {}
    for name in fastest:
        if len(told(unknown[unknown.method == name], QUANTITY)) >= FEWEST:
            models[str(name)] = AtlasModel(atlas[atlas.method == name], QUANTITY)
    return [place for own in slices for place in _drawn(own, models, folder)] if models else []


def _drawn(own: Slice, models: dict[str, AtlasModel], folder: Path) -> list[Path]:
    across, up = own.axes()
    frame = pd.concat([point_frame(point) for point in own.points()], ignore_index=True)
    regions = {name: near for name, model in models.items() if (near := near_bound(frame, model)).any()}
    risky = bool((100.0 * frame.wrong_basin > RISKS[0]).any())
    figure, axes = panels(3 + risky, 2 if risky else 3, 62.0 if risky else 46.0, LABELS[across.name])
    for axis, name, title in zip(axes, ("k_over_m", "c_over_m"), ("k/m", "c/m"), strict=False):
        draw_bound(axis, across, up, frame, f"bound_{name}")
        axis.set_title(f"bound on {title} (%)", loc="left")
    if risky:
        _threshold(axes[2], across, up, frame)
        axes[2].set_title("wrong basin (%)", loc="left")
    letters = _fastest(axes[-1], across, up, frame, regions)
    axes[-1].set_title("fastest method near the bound", loc="left")
    legend_below(figure, [
        *(entry(color="none", marker=f"${letter}$", markerfacecolor="black", markeredgecolor="black",
                markeredgewidth=0.3, markersize=6, label=load_method(name).card.title)
          for name, letter in letters.items()),
        ambiguous_entry(),
        entry(color="none", marker="s", markerfacecolor="white", markeredgecolor="black", markersize=7,
              label="white: the test does not tell k/m, or no method is near"),
    ])  # fmt: skip
    caption = _caption(regions, LABELS[across.name], LABELS[up.name], risky)
    return save_figure(figure, folder, f"atlas_map_{own.name}", caption)


def _caption(regions: dict[str, np.ndarray], across: str, up: str, risky: bool) -> str:
    left, widest = np.ones(1, bool), ("", 0.0)
    for name, near in regions.items():
        own = float(np.mean(near & left))
        left = left & ~near
        widest = max(widest, (name, own), key=lambda pair: pair[1])
    wrong = (
        " Wrong basin: how often the likelihood itself has its highest peak at another frequency, by its threshold."
        if risky
        else f" The likelihood has its highest peak at another frequency on less than {RISKS[0]:g} % of the data sets "
        "everywhere below the Nyquist frequency, so that no panel shows it."
    )
    lead = "No method is near the bound here"
    if widest[0]:
        fastest, share = load_method(widest[0]).card.title, 100.0 * widest[1]
        lead = f"{fastest} is the fastest method near the bound on {share:.0f} % of this map"
    return (
        f"{lead}. Across: {across}; up: {up}. The first panels: the Cramér-Rao bound on k/m and on c/m, light is low, "
        f"with lines at whole powers of ten.{wrong} Last: the fastest of the methods whose error of k/m a model of the "
        f"atlas expects within {NEAR:g} times the bound; light to dark by speed, with letters."
    )


def near_bound(frame: pd.DataFrame, model: AtlasModel) -> np.ndarray:
    """Where a method is expected near the bound."""
    found = np.zeros(len(frame), bool)
    rows = np.flatnonzero(frame.index.isin(told(frame, QUANTITY).index))
    if rows.size:
        every = model.expected(frame.iloc[rows])
        found[rows] = [one.excess[1] <= NEAR and one.gross <= RARE for one in every]
    return found


def _threshold(axis: Any, across: Axis, up: Axis, frame: pd.DataFrame) -> None:
    x, y, z = grid(across, up, frame.assign(own=100.0 * frame.wrong_basin), "own")
    axis.pcolormesh(x, y, z, cmap="Greys", vmin=0.0, vmax=100.0, shading="nearest", rasterized=True)
    if np.nanmax(z) > RISKS[0]:
        axis.clabel(axis.contour(x, y, z, levels=RISKS, colors=LINE, linewidths=0.9), fmt="%g", inline_spacing=1)
    draw_ambiguous(axis, across, up, frame)
    set_scales(axis, across, up)


def _fastest(axis: Any, across: Axis, up: Axis, frame: pd.DataFrame, regions: dict[str, np.ndarray]) -> dict[str, str]:
    """The fastest near method, a grey and a letter each; returns the letters."""
    best = np.full(len(frame), np.nan)
    for i, near in reversed(list(enumerate(regions.values()))):
        best[near] = i
    shown = [name for i, name in enumerate(regions) if (best == i).any()]
    letters = dict(zip(shown, "ABCDEFGHIJ", strict=False))
    x, y, z = grid(across, up, frame.assign(own=best), "own")
    for number, name in enumerate(shown):
        own = np.where(z == list(regions).index(name), 1.0, np.nan)
        colour = one_colour(GREYS[min(number, len(GREYS) - 1)])
        axis.pcolormesh(x, y, own, cmap=colour, shading="nearest", rasterized=True)
        for row in range(1, len(y), EVERY):
            for column in range(1, len(x), EVERY):
                if own[row, column] == 1.0:
                    tone = "white" if number > 3 else "black"
                    axis.text(x[column], y[row], letters[name], ha="center", va="center", fontsize=6, color=tone)
    draw_ambiguous(axis, across, up, frame)
    set_scales(axis, across, up)
    return letters
