"""The leaderboard as a forest plot: every method's distance from the bound with its interval, at every noise level."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bench.entrants.reference import REFERENCES
from bench.reporting.figures.gallery import Gallery, Nothing, Picture, best_first, counts
from bench.reporting.figures.style import entry, legend_below, rows_of_methods
from bench.reporting.frame import Result
from bench.scoring.statistics import RESAMPLES

METRICS = (("k_over_m_error_pct", "k/m"), ("c_over_m_error_pct", "c/m"))
OTHERWISE = (("rmse", "displacement"),)
MOST = 6
"""Noise levels shown at most."""
ROW = 5.6
"""Height of a method (mm)."""
FARTHEST = 100.0
NEAR = 1.25


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
    excesses: dict[str, list[float]] = {}
    for (label, _, _), (excess, _, _) in found.items():
        excesses.setdefault(label, []).append(excess)
    labels = best_first(excesses)
    labels += [c.label for c in dict.fromkeys(cells) if c.label not in labels and c.snr_db in snrs]
    labels = list(dict.fromkeys(labels))
    figure, axes = rows_of_methods([gallery.looks[label] for label in labels], len(snrs), ROW)
    for axis in axes:
        _scale(axis, found)
    for axis, snr in zip(axes, snrs, strict=True):
        _column(axis, gallery, labels, found, [c for c in cells if c.snr_db == snr], metrics)
        axis.set_title(f"{snr:g} dB", loc="center")
    axes[len(snrs) // 2].set_xlabel("root mean square error / Cramér-Rao bound (−)")
    legend_below(figure, _handles([name for _, name in metrics]))
    return Picture(figure, _caption(excesses, cells, [name for _, name in metrics], told))


def _caption(excesses: Mapping[str, Sequence[float]], cells: Sequence[Result], names: Sequence[str], told: str) -> str:
    middles = [float(np.median(own)) for label, own in excesses.items() if label not in REFERENCES]
    on = sum(middle <= NEAR for middle in middles)
    second = f" Filled: {names[0]}; hollow: {names[1]}." if len(names) > 1 else f" Result is the {names[0]}."
    return (
        f"{on} of {len(middles)} methods are within {NEAR:g} times the best that the data allow. Columns are noise "
        f"levels ({cells[0].system}, initial state {told}; {counts(cells)} replicates).{second} Lines are 95 % "
        "intervals (bootstrap over the replicates). At the line at 1 no unbiased method can do better; methods whose "
        "intervals overlap are not told apart by this picture, but may be by the tables, which compare them on the "
        "same data. An arrow: beyond the edge. Failed replicates are left out; where there are any, the number that "
        "succeeded stands beside. The count, and the order to a tenth of the logarithm, are by a method's median "
        "excess over all columns."
    )


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
