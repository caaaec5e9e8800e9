"""The picture of the online track: a quantity along one record, what trackers believed, the bound about the truth."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.online.follow import Followed
from bench.online.scenario import Stream
from bench.online.score import Z95
from bench.reporting.figures.style import MORE_COLOURS, SMALL, entry, legend_below, panels, save_figure, wrapped
from bench.reporting.rounding import readable

SHOWN = 3
"""Trackers of a panel: those nearest to the bound."""
BAND = {"color": "0.8", "lw": 0}
MOST_POINTS = 1200
ROOM = 0.3
"""Part of a panel's height that is kept free above the curves, for the names."""


@dataclass(frozen=True, eq=False)
class ShownTrack:
    """A scenario's first replicate: stream, bound, quantity, and by title each tracker's path with its excess."""

    scenario: str
    stream: Stream
    bound: Mapping[str, np.ndarray]
    quantity: str
    paths: Mapping[str, tuple[Followed, float]]

    @property
    def best(self) -> list[str]:
        """The trackers that are drawn, the one nearest to the bound first."""
        return sorted(self.paths, key=lambda title: self.paths[title][1])[:SHOWN]


def draw_online(shown: Sequence[ShownTrack], folder: Path) -> list[Path]:
    """Draw a panel a scenario; returns the files."""
    if not shown:
        return []
    figure, axes = panels(len(shown), 3, 40.0, "time (s)")
    colours = tracker_colours(title for one in shown for title in one.best)
    for axis, one in zip(axes, shown, strict=True):
        _panel(axis, one, colours)
    legend_below(figure, [
        entry(color="black", lw=1.2, label="truth"), entry(color="0.8", lw=5.0, label="truth ± 1.96 bound"),
        entry(color="0.4", lw=1.0, label="a tracker's estimate, in the colour of its name"),
    ])  # fmt: skip
    return save_figure(figure, folder, "online", caption(shown))


def tracker_colours(titles: Iterable[str]) -> dict[str, str]:
    """The colour of each tracker, the same in all panels."""
    return {title: MORE_COLOURS[i % len(MORE_COLOURS)] for i, title in enumerate(dict.fromkeys(titles))}


def caption(shown: Sequence[ShownTrack]) -> str:
    """What the picture shows."""
    first = [one.best[0] for one in shown if one.best]
    most = max(map(first.count, first))
    leaders = [title for title in dict.fromkeys(first) if first.count(title) == most]
    return (
        f"{' and '.join(leaders)} {'are' if len(leaders) > 1 else 'is'} most often nearest to the bound, in {most} of "
        f"{len(shown)} scenarios{' each' if len(leaders) > 1 else ''}. One record of each scenario: the quantity that "
        f"is tracked, and in grey 95 % of an unbiased estimate's errors at the bound. In colour, by name: the {SHOWN} "
        "trackers nearest to the bound in that scenario, the nearest first and drawn on top, each with its own 95 % "
        "interval in a paler shade. A curve begins where a tracker gives its first estimate; what is beyond a panel's "
        "edge is not drawn."
    )


def _panel(axis: Any, one: ShownTrack, colours: Mapping[str, str]) -> None:
    names = [q.name for q in one.stream.layout.quantities]
    i = names.index(one.quantity)
    true = one.stream.layout.quantities[i].value(one.stream.truth.parameters)
    times, every = one.stream.times, max(1, len(one.stream.times) // MOST_POINTS)
    half = Z95 * np.sqrt(one.bound[one.quantity])
    axis.fill_between(times[::every], (true * np.exp(-half))[::every], (true * np.exp(half))[::every], **BAND)
    axis.plot(times[::every], true[::every], color="black", lw=1.2)
    for title in reversed(one.best):
        path, _ = one.paths[title]
        mean, sd = path.means[::every, i], path.sds[::every, i]
        axis.plot(times[::every], np.exp(mean), color=colours[title], lw=0.9)
        low, high = np.exp(mean - Z95 * sd), np.exp(mean + Z95 * sd)
        axis.fill_between(times[::every], low, high, color=colours[title], alpha=0.18, lw=0)
    axis.set_ylim(*_limits(one, true, half, i))
    axis.set_title(wrapped(readable(one.scenario), 50.0), loc="left")
    axis.set_ylabel(f"{readable(one.quantity)} ({one.stream.layout.quantities[i].unit})")
    _names(axis, one.best, colours)


def _limits(one: ShownTrack, true: np.ndarray, half: np.ndarray, i: int) -> tuple[float, float]:
    """So that the truth, the late bound and the late estimates of the best tracker are seen, below the names."""
    late = slice(len(true) // 10, None)
    centre, reach = float(np.median(true)), max(float(np.ptp(true)), 4.0 * float(np.median((true * half)[late])))
    low, high = centre - 1.1 * reach, centre + 1.1 * reach
    ends = [np.exp(one.paths[title][0].means[-len(true) // 4 :, i]) for title in one.best]
    for own in (end[np.isfinite(end)] for end in ends):
        if own.size:
            low, high = min(low, float(np.quantile(own, 0.1))), max(high, float(np.quantile(own, 0.9)))
    return low, high + ROOM / (1.0 - ROOM) * (high - low)


def _names(axis: Any, titles: Sequence[str], colours: Mapping[str, str]) -> None:
    """The trackers' names in their colours, one under another at the top of the panel."""
    from matplotlib.patheffects import withStroke

    for row, title in enumerate(titles):
        axis.annotate(
            title, (0.98, 0.98), (0, -1.25 * SMALL * row), xycoords="axes fraction", textcoords="offset points",
            ha="right", va="top", fontsize=SMALL, color=colours[title],
            path_effects=[withStroke(linewidth=2.0, foreground="white")],
        )  # fmt: skip
