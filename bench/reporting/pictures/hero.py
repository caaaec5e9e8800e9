"""The first picture: one record with its fit and its intervals, beside accuracy against time of ten methods."""

from __future__ import annotations

import math

import altair as alt
import numpy as np
import pandas as pd

from bench.reporting.frame import Result
from bench.reporting.labels import cards, title
from bench.reporting.paper import own_method
from bench.reporting.pictures.gallery import Arrays, C, Gallery, K, where
from bench.reporting.pictures.responses import curves, over_time, samples
from bench.reporting.pictures.rows import NAMES, excesses, rows, tiers_of, time_and_error
from bench.reporting.pictures.style import Picture, table
from bench.scoring.statistics import Z95

METHODS = 10


def intervals(cell: Result, arrays: Arrays) -> pd.DataFrame:
    """Return estimate and 95 % interval (% from the true value) of k/m and c/m, from a log-normal distribution."""
    names = cell.model.names
    lines = []
    for name in (K, C):
        w = np.array(cell.model.quantity(name).vector(names))
        ratio, sd = cell.first(f"{name}_ratio"), math.sqrt(w @ arrays["covariance"] @ w)
        ends = (100.0 * (ratio * math.exp(sign * Z95 * sd) - 1.0) for sign in (0.0, -1.0, 1.0))
        lines.append((NAMES[name], 0.0, *ends))
    return pd.DataFrame(lines, columns=["method", "rule", "off", "low", "high"])


def draw_hero(gallery: Gallery) -> Picture:
    """Left the record, below it what was found; right ten methods, those of the paper and the best others."""
    scene = [cell for cell in gallery.scene(gallery.main) if not cell.is_reference]
    found = gallery.recorded(scene, "displacement", "displacement_sd", "covariance")
    cell, arrays = next((pair for pair in found if pair[0].label == own_method()), found[0])
    sd, estimate = arrays["displacement_sd"][0], arrays["displacement"][0]
    fit = curves("", arrays["dense_times"], true=arrays["true_displacement"][0], estimate=estimate,
                 low=estimate - Z95 * sd, high=estimate + Z95 * sd)  # fmt: skip
    record = over_time(table(pd.concat([fit, samples("", arrays, 0)])), "displacement (m)")
    off = intervals(cell, arrays)
    reach = 1.2 * float(off[["low", "high"]].abs().max().max())

    def axis(column: str) -> alt.X:
        scale = alt.Scale(domain=[-reach, reach], clamp=True, nice=False)
        return alt.X(f"{column}:Q").scale(scale).title("relative error with 95 % interval (%)")

    below = rows(table(off), [NAMES[K], NAMES[C]], axis, ("off", "low", "high"))
    of_paper = [result.label for result in scene if (card := cards().get(result.label)) and card.paper]
    best = [label for label in gallery.tiers if label not in of_paper and gallery.tiers[label]]
    chosen = [*of_paper, *best][:METHODS]
    selected = (result for result in scene if result.label in chosen)
    frame = excesses(selected, (K,)).drop(columns=["SNR", "quantity", "start"])
    tiers = tiers_of(gallery)
    order = frame.sort_values("seconds").sort_values("method", key=lambda name: name.map(tiers), kind="stable").method
    right = time_and_error(frame, order.tolist(), 17, tiers=tiers, width=80)
    first = frame[frame.method.map(tiers) == 1]
    right = right.properties(title=alt.Title(f"{len(frame)} methods by tier", frame="group"))
    left = alt.vconcat(
        record.properties(width=190, height=110, title=f"one record, fitted by {title(cell.label)}"),
        below.properties(width=190, height=30),
        spacing=8,
    )
    return Picture(
        "hero",
        alt.hconcat(left, right, spacing=12),
        f"{title(cell.label)} fits the record and states the uncertainty; {len(first)} of these {len(frame)} methods "
        f"are in the first tier, and {order.iloc[0]} is the fastest of them. Left: one record ({where(cell)}), the fit "
        "with its 95 % band, and the errors of k/m and c/m with their intervals; true response and values are hidden "
        "from the methods. Right: processor time per fit, and the error of k/m over the Cramér-Rao bound with its 95 % "
        "interval, for the methods of the paper and the best others, by tier of the ranking.",
    )
