"""Pictures whose rows are methods: distance from the bound, time, and performance profiles read along a row."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import altair as alt
import numpy as np
import pandas as pd

from bench.contract.estimate import Status
from bench.entrants.reference import REFERENCES
from bench.reporting.figures.gallery import Gallery, Nothing, Picture, best_first, counts, methods_only, where
from bench.reporting.frame import Result
from bench.reporting.pictures.style import ONE, layered, plain, table
from bench.scoring.statistics import RESAMPLES

K, C, MOTION = ("k_over_m_error_pct", "k/m"), ("c_over_m_error_pct", "c/m"), ("rmse", "displacement")
"""Metrics with what pictures call them."""
NEAR = 1.25
"""A method at most so many times the bound is called near it; alike are those at most so many times the least."""
FARTHEST = 100.0
MOST = 6
"""Noise levels shown at most."""
STARTS = ("known", "unknown")
SHARES = (0.25, 0.5, 0.75, 0.95)
"""Of the data sets, at which a profile is read: a bar from the first to the third, a marker, a line to the last."""
Scene = tuple[str, float]


def _chart(frame: pd.DataFrame, order: Sequence[str], labels: bool = True) -> Any:
    """Rows of a table without marks yet: a method a row."""
    axis = alt.Axis(grid=True, ticks=False, domain=False, labels=labels)
    rows = alt.Y("method:N").sort(list(order)).title(None).axis(axis)
    return alt.Chart(frame).encode(rows, tooltip=list(frame.columns))


def _told_apart(chart: Any, column: str, values: Sequence[str], title: str | None = None) -> Any:
    """Rows with a colour and a place of its own for each value of a column."""
    hue, place = alt.Color(f"{column}:N").sort(list(values)), alt.YOffset(f"{column}:N").sort(list(values))
    return chart.encode(hue.legend(title=title) if len(values) > 1 else hue.legend(None), place)


def _across(column: str, low: float, high: float, title: str | None = None) -> alt.X:
    """A logarithmic axis, at whose ends stands what is beyond."""
    axis = alt.Axis(values=plain(low, high), format="~g", grid=True)
    return alt.X(f"{column}:Q").scale(type="log", domain=[low, high], clamp=True, nice=False).axis(axis).title(title)


def _points(chart: Any, x: alt.X, farthest: float = math.inf) -> Any:
    """A marker a line of the table, a triangle where it is beyond the edge."""
    beyond = f"datum['{x.shorthand.split(':')[0]}'] > {min(farthest, 1e300):g} ? 'triangle-right' : 'circle'"
    shape = alt.Shape("mark:N").scale(None).legend(None)
    return chart.transform_calculate(mark=beyond).mark_point(filled=True, size=11, opacity=1).encode(x, shape)


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
    """A column a noise level, a row a method, best first: distance from the bound with its interval."""
    told = gallery.scene(gallery.main, "unknown")[0].initial_state
    cells = [cell for cell in gallery.main if cell.initial_state == told and cell.label != "prior"]
    metrics = [m for m in (K, C) if any(math.isfinite(c.bound(m[0])) for c in cells)] or [MOTION]
    rows = [
        (c.label, gallery.name(c.label), c.snr_db, c.n_ok, c.n, name, *excess_interval(c.errors(key), c.bound(key)))
        for c in cells
        for key, name in metrics
    ]
    found = pd.DataFrame(rows, columns=["label", "method", "SNR", "ok", "n", "quantity", "excess", "low", "high"])
    known = found.dropna()
    if known.empty:
        raise Nothing("no method with an error and a bound over two replicates or more is stored")
    levels = sorted(set(known.SNR), reverse=True)[:MOST]
    excesses = {label: own.tolist() for label, own in known.groupby("label", sort=False).excess}
    found = found[found.SNR.isin(levels)]
    order = [gallery.name(label) for label in [*best_first(excesses), *found.label] if label in set(found.label)]
    names = [name for _, name in metrics]
    rows_alone = _chart(table(found.drop(columns="label")), list(dict.fromkeys(order)))
    chart = _told_apart(rows_alone, "quantity", names)
    low, high = 0.85 * min(known.low.min(), 0.95), min(FARTHEST, 1.15 * max(known.high.max(), 2.0))
    low = max(low, 0.01)
    excess = _across("excess", low, high)
    some = rows_alone.transform_filter("datum.ok < datum.n").transform_calculate(count="datum.ok + '/' + datum.n")
    layers = layered(
        chart.data,
        alt.Chart(ONE).mark_rule(style="truth").encode(x=alt.datum(1)),
        chart.mark_rule(strokeWidth=1.1).encode(_across("low", low, high), x2="high:Q"),
        _points(chart, excess, high),
        some.mark_text(align="left", dx=2).encode(x=alt.value("width"), text="count:N"),
    ).properties(width=70, height=alt.Step(5 if len(names) > 1 else 9))
    header = alt.Header(labelExpr="datum.value + ' dB'")
    spacing = 30 if (found.ok < found.n).any() else 10
    spaced = layers.facet(column=alt.Column("SNR:Q").sort("descending").header(header), spacing=spacing)
    spaced = spaced.properties(title=alt.Title("root mean square error / Cramér-Rao bound (−)", anchor="middle"))
    middles = [float(np.median(own)) for label, own in excesses.items() if label not in REFERENCES]
    return Picture(
        spaced,
        f"{sum(middle <= NEAR for middle in middles)} of {len(middles)} methods are within {NEAR:g} times the best "
        f"that the data allow. Columns are noise levels ({cells[0].system}, initial state {told}; {counts(cells)} "
        f"replicates), colours the {' and the '.join(names)}. Lines are 95 % intervals (bootstrap over the "
        "replicates). At the line at 1 no unbiased method can do better; methods whose intervals overlap are not told "
        "apart by this picture, but may be by the tables, which compare them on the same data. A triangle: beyond the "
        "edge. Failed replicates are left out; where there are any, the number that succeeded stands beside. The "
        "count, and the order to a tenth of the logarithm, are by a method's median excess over all columns.",
    )


def draw_time(gallery: Gallery) -> Picture:
    """Time on the left, error over the bound on the right, fastest first; what is far from the bound is paler."""
    usual = gallery.scene(gallery.main, "known")[0].snr_db
    cells = [c for c in methods_only(gallery.main) if c.snr_db == usual and c.initial_state in STARTS]
    choices = [(name, frame) for metric, name in (K, MOTION) if len(frame := _times(gallery, cells, metric))]
    if not choices:
        raise Nothing("no method with a time and an excess is stored")
    name, found = choices[0]
    slowest = found.groupby("method", sort=False).seconds.max().sort_values(kind="stable")
    found["near"] = found.method.map(found.groupby("method").excess.max() <= NEAR)
    near = [method for method in slowest.index if found[found.method == method].near.all()]
    starts = [told for told in STARTS if told in set(found.start)]
    frame = table(found)
    pale = alt.condition("datum.near", alt.value(1.0), alt.value(0.35))
    rows = (_chart(frame, list(slowest.index), labels).encode(opacity=pale) for labels in (True, False))
    left, right = (_told_apart(own, "start", starts, "initial state") for own in rows)
    limits = 0.8 * found.seconds.min(), 1.2 * found.slowest.max()
    seconds = _across("seconds", *limits, "processor time of a fit (s)")
    excess = _across("excess", min(0.9, 0.9 * found.excess.min()), 1.15 * found.excess.max(),
                     f"error of {name} / bound (−)")  # fmt: skip
    panels = (
        layered(frame, left.mark_rule().encode(seconds, x2="slowest:Q"), _points(left, seconds)),
        layered(frame, alt.Chart(ONE).mark_rule(style="truth").encode(x=alt.datum(1)), _points(right, excess)),
    )
    chart = alt.hconcat(*(own.properties(width=150, height=alt.Step(5)) for own in panels), data=frame, spacing=12)
    lead = f"{near[0]} is the fastest method near the bound" if near else "No method is near the bound"
    two = " Colours tell whether the initial state is known." if len(starts) > 1 else f" Initial state {starts[0]}."
    return Picture(
        chart,
        f"{lead}. Left: processor time of a fit, fastest first ({where(cells[0]).rpartition(', initial state')[0]}); "
        "the marker is the median fit, everything loaded, and the line goes to the slowest, often the first of a "
        "process, which loads and builds what the method needs. Right: root mean square error of "
        f"{name} over its Cramér-Rao bound; left is better, 1 is the best that the data allow.{two} Pale: more than "
        f"{NEAR:g} times the bound from one of the starts.",
    )


def _times(gallery: Gallery, cells: Sequence[Result], metric: str) -> pd.DataFrame:
    """Of each cell that has both: median and longest time (s) of a fit, and the error over the bound."""
    rows = []
    for cell in cells:
        ok = np.array([status is Status.OK for status in cell.statuses])
        seconds = np.sort(cell.cpu_s[ok & np.isfinite(cell.cpu_s) & (cell.cpu_s > 0)])
        excess = cell.summary.get(metric, {}).get("excess", math.nan)
        if seconds.size and math.isfinite(excess) and excess > 0:
            median, longest = float(seconds[seconds.size // 2]), float(seconds[-1])
            rows.append((gallery.name(cell.label), cell.initial_state, median, longest, excess))
    return pd.DataFrame(rows, columns=["method", "start", "seconds", "slowest", "excess"])


def draw_profiles(gallery: Gallery) -> Picture:
    """A column a metric: within what factors of the best error a method is, and how often."""
    told = gallery.scene(gallery.main, "unknown")[0].initial_state
    labels, scenes, cells = common(gallery, told)
    if len(labels) < 2:
        raise Nothing("a comparison needs two methods on the same data")
    chosen = [cells[label, scene] for label in labels for scene in scenes]
    fewest = min(c.n for c in chosen)
    metrics = [m for m in (K, C, MOTION) if all(np.isfinite(c.scores(m[0])).any() or not c.n_ok for c in chosen)]
    if not metrics:
        raise Nothing("no error that all methods have is stored")
    found = {name: factors(joined(labels, scenes, cells, metric, fewest)) for metric, name in metrics}
    first = next(iter(found.values()))
    order = sorted(labels, key=lambda label: tuple(first[label][[1, 2, 3, 0]]))
    columns = ["method", "quantity", "quarter", "median", "three quarters", "most"]
    rows = [
        (gallery.name(label), name, *np.minimum(own[label], 2.0 * FARTHEST))
        for name, own in found.items()
        for label in order
    ]
    frame, names = table(pd.DataFrame(rows, columns=columns)), [name for _, name in metrics]
    chart = _chart(frame, [gallery.name(label) for label in order])
    chart = chart.encode(alt.Color("quantity:N").sort(names).legend(None))
    x = {column: _across(column, 1.0, FARTHEST) for column in columns[2:]}
    layers = layered(
        chart.data,
        chart.mark_rule(strokeWidth=0.9).encode(x["three quarters"], x2="most:Q"),
        chart.mark_rule(strokeWidth=3.5, opacity=0.5).encode(x["quarter"], x2="three quarters:Q"),
        _points(chart, x["median"], FARTHEST),
        _points(chart.transform_filter(f"datum.most > {FARTHEST}"), x["most"], FARTHEST),
    ).properties(width=100, height=alt.Step(10))
    columns_of = alt.Column("quantity:N").sort(names)
    spaced = layers.facet(column=columns_of, spacing=12)
    spaced = spaced.properties(title=alt.Title("error / least of all methods (−)", anchor="middle"))
    middle = [first[label][SHARES.index(0.5)] for label in order]
    alike = sum(own <= NEAR * middle[0] for own in middle)
    levels = ", ".join(f"{snr:g}" for snr in sorted({snr for _, snr in scenes}, reverse=True))
    low, half, high, most = (f"{100.0 * share:g} %" for share in SHARES)
    return Picture(
        spaced,
        f"{alike} of {len(order)} methods are about equally often near the least error of {names[0]}. Over "
        f"{len(scenes)} scenarios ({len({c.series for c in chosen})} parameter sets, {levels} dB, initial state {told}"
        f"), the first {fewest} replicates of each, on which every method here was run: how many times the least error "
        f"of all methods on the same data a method's error is, read off its performance profile. Marker: {half} of "
        f"the data sets are within; bar: from {low} to {high}; line: up to {most}. Further left is better. A failed "
        "fit is within no factor, and a triangle is beyond the edge. Methods on the bound take turns at being best by "
        "luck, so that none is always at the edge; what tells them from others is how far the line reaches. About "
        f"equally often: the markers of the first column are within {NEAR:g} times the leftmost. Methods in order of "
        "that column.",
    )


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


def factors(errors: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
    """By method, within what factors of the least error it is on SHARES of the data sets (4,); infinite if on fewer.

    Read off its performance profile (E. D. Dolan, J. J. Moré, Math. Program. 91:201, 2002).
    """
    least = np.min(np.stack(list(errors.values())), axis=0)
    found = {}
    for method, own in errors.items():
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(own == least, 1.0, own / least)
        ratio = np.sort(np.where(np.isfinite(own), ratio, np.inf))
        found[method] = ratio[[math.ceil(share * ratio.size) - 1 for share in SHARES]]
    return found


def joined(
    labels: Sequence[str], scenes: Sequence[Scene], cells: dict[tuple[str, Scene], Result], metric: str, n: int
) -> dict[str, np.ndarray]:
    """The errors of every method on the first ``n`` replicates of every scenario, failures infinite."""
    values = {label: np.concatenate([cells[label, scene].errors(metric)[:n] for scene in scenes]) for label in labels}
    if not any(np.isfinite(own).any() for own in values.values()):
        raise Nothing("every replicate failed")
    return values
