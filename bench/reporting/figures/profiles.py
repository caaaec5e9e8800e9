"""Performance profiles, read along a row: within what factors of the best error a method is, and how often."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bench.reporting.figures.gallery import Gallery, Nothing, Picture, methods_only
from bench.reporting.figures.style import Look, entry, legend_below, rows_of_methods
from bench.reporting.frame import Result
from bench.scoring.comparison import Errors

METRICS = (("k_over_m_error_pct", "k/m"), ("c_over_m_error_pct", "c/m"), ("rmse", "displacement"))
SHARES = (0.25, 0.5, 0.75, 0.95)
"""Of the data sets, at which a row is read: a bar from the first to the third, a marker, a line to the last."""
FARTHEST = 100.0
ALIKE = 1.25
"""Methods whose factor on half of the data sets is at most so many times the least are called alike."""
Scene = tuple[str, float]


def common(gallery: Gallery, told: str) -> tuple[list[str], list[Scene], dict[tuple[str, Scene], Result]]:
    """Methods and scenarios of which the store has every cell, as many cells as possible.

    Undisturbed scenarios with the main one's prior, seed and start.
    """
    main = gallery.main[0]
    cells = {
        (c.label, (c.series, c.snr_db)): c
        for c in methods_only(gallery.cells)
        if (c.initial_state, c.seed, c.disturbance) == (told, main.seed, main.disturbance)
        and (c.prior, c.truth_drawn) == (main.prior, main.truth_drawn)
        and c.kind == main.kind
    }
    scenes: dict[str, set[Scene]] = {}
    for label, scene in cells:
        scenes.setdefault(label, set()).add(scene)
    order = sorted(scenes, key=lambda label: -len(scenes[label]))
    chosen, best = list[str](), set[Scene]()
    for i in range(1, len(order) + 1):
        shared = set.intersection(*(scenes[label] for label in order[:i]))
        if i * len(shared) > len(chosen) * len(best):
            chosen, best = order[:i], shared
    return [label for label in gallery.looks if label in chosen], sorted(best), cells


def draw_profiles(gallery: Gallery) -> Picture:
    """One panel a metric."""
    told = gallery.scene(gallery.main, "unknown")[0].initial_state
    labels, scenes, cells = common(gallery, told)
    if len(labels) < 2:
        raise Nothing("a comparison needs two methods on the same data")
    chosen = [cells[label, scene] for label in labels for scene in scenes]
    fewest = min(c.n for c in chosen)
    metrics = [m for m in METRICS if all(c.has(m[0]) or not c.n_ok for c in chosen)]
    if not metrics:
        raise Nothing("no error that all methods have is stored")
    found = {name: factors(joined(labels, scenes, cells, metric, fewest)) for metric, name in metrics}
    first = next(iter(found.values()))
    order = sorted(labels, key=lambda label: tuple(first[label][[1, 2, 3, 0]]))
    figure, axes = rows_of_methods([gallery.looks[label] for label in order], len(metrics))
    for axis, (name, own) in zip(axes, found.items(), strict=True):
        for row, label in enumerate(order):
            _row(axis, row, gallery.looks[label], own[label])
        axis.set(xscale="log", xlim=(1.0, FARTHEST))
        axis.set_xticks([1, 10, 100], ["1", "10", "100"])
        axis.set_title(name, loc="left")
    axes[len(axes) // 2].set_xlabel("error / least of all methods (−)")
    legend_below(figure, _handles())
    middle = [first[label][SHARES.index(0.5)] for label in order]
    alike = sum(own <= ALIKE * middle[0] for own in middle)
    systems = len({c.series for c in chosen})
    levels = ", ".join(f"{snr:g}" for snr in sorted({snr for _, snr in scenes}, reverse=True))
    data = f"{len(scenes)} scenarios ({systems} parameter sets, {levels} dB, initial state {told})"
    lead = f"{alike} of {len(order)} methods are about equally often near the least error of {metrics[0][1]}."
    return Picture(figure, f"{lead} {_caption(data, fewest)}")


def _caption(data: str, replicates: int) -> str:
    first, middle, third, last = (f"{100.0 * share:g} %" for share in SHARES)
    return (
        f"Over {data}, the first {replicates} replicates of each, on which every method here was run: how many times "
        "the least error of all methods on the same data a method's error is, read off its performance profile. "
        f"Marker: {middle} of the data sets are within; bar: from {first} to {third}; line: up to {last}. Further left "
        "is better. A failed fit is within no factor, and an arrow is beyond the edge. Methods on the bound take turns "
        "at being best by luck, so that none is always at the edge; what tells them from others is how far the line "
        f"reaches. About equally often: the markers of the first column are within {ALIKE:g} times the leftmost. "
        "Methods in order of that column."
    )


def factors(errors: Errors) -> Mapping[str, np.ndarray]:
    """By method, within what factors of the least error it is on SHARES of the data sets (4,); infinite if on fewer.

    Read off its performance profile (E. D. Dolan, J. J. Moré, Math. Program. 91:201, 2002).
    """
    least = np.min(np.stack(list(errors.values.values())), axis=0)
    found = {}
    for method, own in errors.values.items():
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(own == least, 1.0, own / least)
        ratio = np.sort(np.where(np.isfinite(own), ratio, np.inf))
        found[method] = ratio[[math.ceil(share * ratio.size) - 1 for share in SHARES]]
    return found


def _row(axis: Any, row: int, look: Look, values: np.ndarray) -> None:
    low, _, high, most = np.minimum(values, FARTHEST)
    axis.plot([high, most], [row, row], color=look.colour, lw=0.9, zorder=2, solid_capstyle="butt")
    axis.plot([low, high], [row, row], color=look.colour, lw=3.2, alpha=0.5, zorder=2, solid_capstyle="butt")
    for value, style in ((values[1], look.point(4.2)), (values[3], {**look.point(0.0), "marker": "|", "ms": 4.0})):
        if value <= FARTHEST:
            axis.plot(value, row, ls="none", zorder=3, **style)
    if values[3] > FARTHEST:
        arrow = {"marker": (3, 0, 270.0), "ms": 3.4, "color": look.colour, "clip_on": False}
        axis.plot(FARTHEST, row, ls="none", zorder=3, **arrow)


def _handles() -> list[Any]:
    first, middle, third, last = (f"{100.0 * share:g}" for share in SHARES)
    return [
        entry(color="0.3", marker="o", ms=4.2, ls="none", label=f"{middle} % of the data sets are within"),
        entry(color="0.3", lw=3.2, alpha=0.5, label=f"{first} to {third} %"),
        entry(color="0.3", lw=0.9, marker="|", ms=4.0, label=f"to {last} %"),
    ]


def joined(
    labels: Sequence[str], scenes: Sequence[Scene], cells: dict[tuple[str, Scene], Result], metric: str, n: int
) -> Errors:
    """The errors of every method on the first ``n`` replicates of every scenario, failures infinite."""
    values = {label: np.concatenate([cells[label, scene].errors(metric)[:n] for scene in scenes]) for label in labels}
    least = [own.min() for own in values.values() if math.isfinite(own.min())]
    if not least:
        raise Nothing("every replicate failed")
    return Errors(values, np.repeat(np.arange(len(scenes)), n))
