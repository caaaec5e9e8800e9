"""The picture of the online track: a quantity along one record, what trackers believed, the bound about the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.online.follow import Followed
from bench.online.scenario import Stream
from bench.online.score import Z95
from bench.reporting.figures.style import legend_below, panels, save_figure
from bench.reporting.rounding import readable

SHOWN = 3
"""Trackers of a panel: those nearest to the bound."""
COLOURS = ("#4477AA", "#EE6677", "#228833")
MOST_POINTS = 1200


@dataclass(frozen=True, eq=False)
class Shown:
    """A scenario's first replicate: stream, bound, quantity, and by title each tracker's path with its excess."""

    scenario: str
    stream: Stream
    bound: Mapping[str, np.ndarray]
    quantity: str
    paths: Mapping[str, tuple[Followed, float]]


def draw_online(shown: Sequence[Shown], folder: Path) -> list[Path]:
    """Draw a panel a scenario; returns the files."""
    if not shown:
        return []
    figure, axes = panels(len(shown), 2, 48.0, "time (s)")
    for axis, one in zip(axes, shown, strict=False):
        _panel(axis, one)
    handles, labels = axes[0].get_legend_handles_labels()
    keep = [(h, lab) for h, lab in zip(handles, labels, strict=True) if lab in ("truth", "truth ± 1.96 bound")]
    for handle, label in keep:
        handle.set_label(label)
    legend_below(figure, [handle for handle, _ in keep])
    folder.mkdir(parents=True, exist_ok=True)
    return save_figure(figure, folder, "online")


def _panel(axis: Any, one: Shown) -> None:
    names = [q.name for q in one.stream.layout.quantities]
    i = names.index(one.quantity)
    true = one.stream.layout.quantities[i].value(one.stream.truth.parameters)
    times, every = one.stream.times, max(1, len(one.stream.times) // MOST_POINTS)
    half = Z95 * np.sqrt(one.bound[one.quantity])
    axis.fill_between(
        times[::every], (true * np.exp(-half))[::every], (true * np.exp(half))[::every],
        color="#bbbbbb", lw=0, label="truth ± 1.96 bound",
    )  # fmt: skip
    axis.plot(times[::every], true[::every], color="black", lw=1.2, label="truth")
    best = sorted(one.paths.items(), key=lambda item: item[1][1])[:SHOWN]
    for colour, (title, (path, _)) in zip(COLOURS, best, strict=False):
        mean, sd = path.means[::every, i], path.sds[::every, i]
        axis.plot(times[::every], np.exp(mean), color=colour, lw=1.0, label=title)
        axis.fill_between(
            times[::every], np.exp(mean - Z95 * sd), np.exp(mean + Z95 * sd), color=colour, alpha=0.18, lw=0
        )
    late = slice(len(true) // 10, None)
    centre, reach = float(np.median(true)), max(float(np.ptp(true)), 4.0 * float(np.median((true * half)[late])))
    axis.set_ylim(centre - 1.1 * reach, centre + 1.6 * reach)  # the legend stands above the curves
    axis.set_title(readable(one.scenario), fontsize=10)
    axis.set_ylabel(readable(one.quantity))
    drawn = [line for line in axis.get_lines() if line.get_label() in one.paths]
    axis.legend(handles=drawn, fontsize=6, loc="upper right", ncols=3, framealpha=0.9, edgecolor="none")
