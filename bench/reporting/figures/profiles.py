"""Performance profiles: on what share of all data sets a method is within a factor of the best."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from bench.reporting.figures.gallery import Gallery, Nothing, Picture, methods_only
from bench.reporting.figures.style import FULL, MM, handle, legend_below, pyplot
from bench.reporting.frame import Result
from bench.scoring.comparison import Errors, profile

METRICS = (("k_over_m_error_pct", "k/m"), ("c_over_m_error_pct", "c/m"), ("rmse", "displacement"))
FACTORS = np.geomspace(1.0, 100.0, 161)
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
    figure, axes = pyplot().subplots(
        1, len(metrics), figsize=(FULL, 62.0 * MM), layout="constrained", sharey=True, squeeze=False
    )
    for axis, (metric, name) in zip(axes[0], metrics, strict=True):
        shares = profile(joined(labels, scenes, cells, metric, fewest), list(FACTORS))
        for i, label in enumerate(labels):
            look, own = gallery.looks[label], 100.0 * shares[label]
            start = (7 * i) % 32
            axis.plot(FACTORS, own, color=look.colour, lw=1.0, markevery=(start, 32), **look.point(4.0))
        axis.set(xscale="log", xlim=(1.0, FACTORS[-1]), ylim=(0, 103), xlabel="error / least of all methods (−)")
        axis.set_xticks([1, 10, 100], ["1", "10", "100"])
        axis.set_title(name, loc="left")
        axis.grid()
    axes[0][0].set_ylabel("share of the data sets (%)")
    legend_below(figure, [handle(gallery.looks[label]) for label in labels])
    systems = len({c.series for c in chosen})
    levels = ", ".join(f"{snr:g}" for snr in sorted({snr for _, snr in scenes}, reverse=True))
    return Picture(
        figure,
        f"Performance profiles over {len(scenes)} scenarios ({systems} parameter sets, {levels} dB, initial state "
        f"{told}), the first {fewest} replicates of each, on which every method here was run: on what share of these "
        "data sets the error is within so many times the least error of all methods. A line further up and to the left "
        "is better; where it ends says how often the method is not grossly wrong. A failed fit is within no factor. "
        "Close to the left edge methods on the bound take turns by luck; what tells is how soon a line reaches the "
        "top.",
    )


def joined(
    labels: Sequence[str], scenes: Sequence[Scene], cells: dict[tuple[str, Scene], Result], metric: str, n: int
) -> Errors:
    """The errors of every method on the first ``n`` replicates of every scenario, failures infinite."""
    values = {label: np.concatenate([cells[label, scene].errors(metric)[:n] for scene in scenes]) for label in labels}
    least = [own.min() for own in values.values() if math.isfinite(own.min())]
    if not least:
        raise Nothing("every replicate failed")
    return Errors(values, np.repeat(np.arange(len(scenes)), n))
