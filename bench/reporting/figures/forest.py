"""The leaderboard as a forest plot: every method's distance from the bound with its interval, at every noise level."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.reporting.figures.gallery import Gallery, Nothing, Picture, counts
from bench.reporting.figures.style import FULL, MM, entry, legend_below, pyplot
from bench.reporting.frame import Result
from bench.scoring.summary import RESAMPLES

METRICS = (("k_over_m_error_pct", "k/m"), ("c_over_m_error_pct", "c/m"))
OTHERWISE = (("rmse", "displacement"),)
MOST = 6
"""Noise levels shown at most."""
ROW = 5.6
"""Height of a method (mm)."""
FARTHEST = 100.0


def excess_interval(errors: np.ndarray, bound: float) -> tuple[float, float, float]:
    """Root mean square of errors (n,) over their bound, with its 95 % bootstrap interval; NaNs for fewer than two.

    Errors that are not finite (failures) are left out.
    """
    squares = errors[np.isfinite(errors)] ** 2
    if squares.size < 2 or not (math.isfinite(bound) and bound > 0):
        return math.nan, math.nan, math.nan
    index = np.random.default_rng(0).integers(0, squares.size, (RESAMPLES, squares.size))
    low, high = np.quantile(np.sqrt(squares[index].mean(axis=1)), [0.025, 0.975]) / bound
    return float(np.sqrt(squares.mean()) / bound), float(low), float(high)


def draw_forest(gallery: Gallery) -> Picture:
    """A column a noise level, a row a method, best first."""
    told = gallery.scene(gallery.main, "unknown")[0].initial_state
    cells = [cell for cell in gallery.main if cell.initial_state == told and cell.label != "prior"]
    metrics = [m for m in METRICS if any(math.isfinite(c.bound(m[0])) for c in cells)] or list(OTHERWISE)
    found = {
        (c.label, c.snr_db, metric): own
        for c in cells
        for metric, _ in metrics
        if math.isfinite((own := excess_interval(c.errors(metric), c.bound(metric)))[0])
    }
    if not found:
        raise Nothing("no method with an error and a bound over two replicates or more is stored")
    snrs = sorted({snr for _, snr, _ in found}, reverse=True)[:MOST]
    labels = _ranked(found)
    labels += [c.label for c in dict.fromkeys(cells) if c.label not in labels and c.snr_db in snrs]
    labels = list(dict.fromkeys(labels))
    figure, axes = pyplot().subplots(
        1, len(snrs), figsize=(FULL, (22.0 + ROW * len(labels)) * MM), layout="constrained", sharey=True, sharex=True,
        squeeze=False,
    )  # fmt: skip
    _scale(axes[0][0], found)
    for axis, snr in zip(axes[0], snrs, strict=True):
        _column(axis, gallery, labels, found, [c for c in cells if c.snr_db == snr], metrics)
        axis.set_title(f"{snr:g} dB", loc="center")
    axes[0][0].set_yticks(range(len(labels)), [gallery.looks[label].title for label in labels])
    axes[0][0].set_ylim(len(labels) - 0.4, -0.6)
    axes[0][len(snrs) // 2].set_xlabel("root mean square error / Cramér-Rao bound (−)")
    legend_below(figure, _handles([name for _, name in metrics]))
    return Picture(figure, _caption(cells, [name for _, name in metrics], told))


def _caption(cells: Sequence[Result], names: Sequence[str], told: str) -> str:
    second = f" Filled: {names[0]}; hollow: {names[1]}." if len(names) > 1 else f" Result is the {names[0]}."
    return (
        f"How far each method is from the best that the data allow, at each noise level ({cells[0].system}, initial "
        f"state {told}; {counts(cells)} replicates).{second} Lines are 95 % intervals (bootstrap over the replicates). "
        "At the line at 1 no unbiased method can do better; methods whose intervals overlap are not told apart by this "
        "picture, but may be by the tables, which compare them on the same data. An arrow: beyond the edge. Failed "
        "replicates are left out; where there are any, the number that succeeded stands beside. Methods in order of "
        "their median excess over all columns, to a tenth."
    )


def _ranked(found: dict[tuple[str, float, str], tuple[float, float, float]]) -> list[str]:
    """Methods by the median of their logarithmic excess, best first, to a tenth; those that tie in the usual order."""
    own: dict[str, list[float]] = {}
    for (label, _, _), (excess, _, _) in found.items():
        own.setdefault(label, []).append(math.log(max(excess, 1.0)))  # below 1 there is nothing to be won
    return sorted(own, key=lambda label: (round(float(np.median(own[label])), 1), list(own).index(label)))


def _column(
    axis: Any,
    gallery: Gallery,
    labels: Sequence[str],
    found: dict[tuple[str, float, str], tuple[float, float, float]],
    cells: Sequence[Result],
    metrics: Sequence[tuple[str, str]],
) -> None:
    axis.axvline(1.0, color="black", lw=0.9, zorder=1)
    for cell in cells:
        if cell.label not in labels:
            continue
        row, look = labels.index(cell.label), gallery.looks[cell.label]
        for i, (metric, _) in enumerate(metrics):
            if (cell.label, cell.snr_db, metric) in found:
                middle, low, high = found[cell.label, cell.snr_db, metric]
                at = row + (0.36 * i - 0.18 if len(metrics) > 1 else 0.0)
                _interval(axis, look, at, (middle, low, high), hollow=i > 0)
        if cell.n_ok < cell.n:
            spans = [found[key] for key in ((cell.label, cell.snr_db, metric) for metric, _ in metrics) if key in found]
            _count(axis, row, f"{cell.n_ok}/{cell.n}", [(low, high) for _, low, high in spans])
    for row in range(1, len(labels), 2):
        axis.axhspan(row - 0.5, row + 0.5, color="0.955", lw=0, zorder=0)
    axis.tick_params(axis="y", length=0)


def _count(axis: Any, row: int, text: str, spans: Sequence[tuple[float, float]]) -> None:
    """How many replicates succeeded: at the right edge, or the next place to the left that is free."""
    left, right = np.log(axis.get_xlim())
    taken = [((np.log(max(low, 1e-9)) - left), (np.log(min(high, FARTHEST)) - left)) for low, high in spans]
    taken = [(low / (right - left) - 0.06, high / (right - left) + 0.06) for low, high in taken]
    width = 0.065 * len(text)
    ends = np.arange(0.99, width, -0.05)
    at = next((end for end in ends if all(high <= end - width or low >= end for low, high in taken)), 0.99)
    axis.text(at, row, text, transform=axis.get_yaxis_transform(), ha="right", va="center", fontsize=7, zorder=2)


def _interval(axis: Any, look: Any, at: float, values: tuple[float, float, float], hollow: bool) -> None:
    middle, low, high = (min(value, FARTHEST) for value in values)
    axis.plot([low, high], [at, at], color=look.colour, lw=1.1, zorder=3, solid_capstyle="butt")
    style = look.point(3.4, hollow) | {"mew": 0.8, "zorder": 4}
    if hollow:
        style["mfc"] = "white"
    if values[0] > FARTHEST:
        style |= {"marker": (3, 0, 270.0), "clip_on": False}
    axis.plot(middle, at, ls="none", **style)


def _scale(axis: Any, found: dict[Any, tuple[float, float, float]]) -> None:
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

    highest = min(max(high for _, _, high in found.values()), FARTHEST)
    lowest = max(min(low for _, low, _ in found.values()), 0.01)
    axis.set(xscale="log", xlim=(0.85 * min(lowest, 0.95), 1.15 * max(highest, 2.0)))
    decades = highest / lowest > 12
    ticks = [0.01, 0.1, 1.0, 10.0, 100.0] if decades else [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0]
    axis.xaxis.set_major_locator(FixedLocator(ticks))
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.xaxis.set_minor_formatter(NullFormatter())


def _handles(names: Sequence[str]) -> list[Any]:

    faces = ("0.3", "white")
    style = {"color": "0.3", "marker": "o", "ms": 3.6, "mew": 0.8, "lw": 1.1}
    return [entry(**style, mfc=face, label=name) for face, name in zip(faces, names, strict=False)]
