"""Pictures whose rows are methods: distance from the bound, what intervals hold, time, and the family of PINNs."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from itertools import groupby
from typing import Any

import altair as alt
import numpy as np
import pandas as pd

from bench.config.experiment import Experiment
from bench.entrants.reference import REFERENCES
from bench.reporting.family import PLACE, Section, family_of
from bench.reporting.frame import Result, experiment_frame, group, table_experiments
from bench.reporting.labels import title
from bench.reporting.pictures.gallery import METRICS, MOTION, C, Gallery, K, replicates, where
from bench.reporting.pictures.style import Nothing, Picture, layered, logarithmic, table
from bench.reporting.tables.family import NEAR as ORACLE
from bench.reporting.tables.family import oracle_seconds
from bench.reporting.tables.pooling import root_mean_square
from bench.scoring.statistics import counts, middle_95, wilson_interval
from bench.scoring.traces import MOMENTS

NEAR = 1.25
"""A method at most so many times the bound is called near it."""
FARTHEST, NEAREST = 100.0, 0.3
"""Error over bound: what is beyond stands at the edge."""
MOST = 6
"""Noise levels shown at most."""
FEWEST = 20
"""Replicates: of fewer a share says nothing."""
LEVELS = (50, 80, 95)
NAMES = {K: "k/m", C: "c/m", MOTION: "displacement"}
"""What pictures call a quantity."""
COMPARED = (("optimizer", 0), ("optimizer", 1), ("weighting", 0), ("architecture", 0))
"""The setting that a part of the family's picture varies, and around which base."""
Across = Callable[[str], alt.X]
"""The axis of a column."""


def rows(
    frame: pd.DataFrame, order: Sequence[str], across: Across, columns: tuple[str, str, str], *, by: str = "",
    tiers: Mapping[str, int] | None = None, labels: bool = True,
) -> Any:  # fmt: skip
    """Return a row for each method, with a marker, and a line between two ends.

    Args:
        frame: The data, with a column ``method``; a line across all rows stands where its column ``rule`` says.
        order: The methods, from above.
        across: The axis, whose clamped scale keeps at its edge, as a triangle, what is beyond.
        columns: Those of the marker and of the ends of the line.
        by: The column that gives colours, with a place of its own in the row each.
        tiers: By method, the tier of the ranking; a stronger line stands above the first method of each.
        labels: Whether the rows are named.
    """
    first = [next(own) for _, own in groupby(order, lambda name: (tiers or {}).get(name, 0))]
    width: Any = {"condition": {"test": {"field": "value", "oneOf": first[1:]}, "value": 1.6}, "value": 0.4}
    axis = alt.Axis(grid=True, gridWidth=width, bandPosition=0, ticks=False, domain=False, labels=labels)
    tips = [name for name in frame.columns if name not in ("rule", "edge")]
    chart = alt.Chart(frame).encode(alt.Y("method:N").sort(list(order)).title(None).axis(axis), tooltip=tips)
    if by:
        values = list(dict.fromkeys(frame[by]))
        chart = chart.encode(alt.Color(f"{by}:N").sort(values), alt.YOffset(f"{by}:N").sort(values))
    marker, low, high = columns
    end = across(marker).to_dict()["scale"]["domain"][1]  # type: ignore[call-overload]
    beyond = f"datum['{marker}'] > {end}"
    shape = alt.condition(beyond, alt.value("triangle-right"), alt.value("circle"))
    return layered(
        frame,
        alt.Chart(frame).mark_rule(style="truth").encode(across("mean(rule)")),
        chart.mark_rule(strokeWidth=1.1).encode(across(low), x2=f"{high}:Q"),
        chart.mark_point(filled=True, size=11, opacity=1).encode(across(marker), shape=shape),
    )


def log_axis(column: str, low: float, high: float, name: str) -> alt.X:
    """Return a logarithmic axis between two limits."""
    scale, axis = logarithmic(low, high)
    return alt.X(f"{column}:Q").scale(scale).axis(axis).title(name)


def excess_interval(errors: np.ndarray, bound: float) -> tuple[float, float, float]:
    """Return the root mean square of errors (n,) over their bound, with its 95 % bootstrap interval.

    Errors that are not finite (failures) are left out; NaNs for fewer than two.
    """
    squares = errors[np.isfinite(errors)] ** 2
    if squares.size < 2 or not bound > 0:
        return math.nan, math.nan, math.nan
    low, high = middle_95(np.sqrt(squares @ counts(squares.size) / squares.size))
    return float(np.sqrt(squares.mean())) / bound, low / bound, high / bound


def excesses(cells: Iterable[Result], quantities: Iterable[str]) -> pd.DataFrame:
    """Return the error over the bound of each cell and quantity, with its interval and the time of a fit (s)."""
    lines = [
        (title(cell.label), cell.snr_db, f"initial state {cell.initial_state}", NAMES[name],
         f"{cell.n_ok} of {cell.n}", *_seconds(cell), *excess_interval(cell.errors(METRICS[name]),
                                                                       cell.bound(METRICS[name])))
        for cell in cells for name in quantities
    ]  # fmt: skip
    columns = ["method", "SNR", "start", "quantity", "fits", "seconds", "slowest", "excess", "low", "high"]
    found = pd.DataFrame(lines, columns=columns).dropna().assign(begins=lambda own: own.seconds)
    if found.empty:
        raise Nothing("no method with an error and a bound over two replicates or more is stored")
    return found


def _seconds(cell: Result) -> tuple[float, float]:
    """The median and the longest time (s) of a successful fit."""
    seconds = cell.cpu_s[cell.ok]
    return (float(np.median(seconds)), float(seconds.max())) if seconds.size else (math.nan, math.nan)


def tiers_of(gallery: Gallery) -> dict[str, int]:
    """Return the tier of each method, as pictures call it; 99 beside the tiers."""
    return {title(label): tier or 99 for label, tier in gallery.tiers.items()}


def _spoken(gallery: Gallery) -> str:
    """What a caption says of tiers."""
    tiers = list(gallery.tiers.values())
    return (
        f"Methods stand by tier of the ranking over these scenarios ({tiers.count(1)} of {len(tiers)} are in the "
        "first), a stronger line between tiers; those that do not serve all stand last."
    )


def draw_forest(gallery: Gallery) -> Picture:
    """A column a noise level: distance from the bound with its interval."""
    start = gallery.scene(gallery.main, "unknown")[0].initial_state
    cells = [cell for cell in gallery.main if cell.initial_state == start and cell.label != "prior"]
    frame = excesses(cells, (K, C) if any(cell.bound(METRICS[K]) > 0 for cell in cells) else (MOTION,))
    frame = frame[frame.SNR.isin(sorted(set(frame.SNR))[-MOST:])].assign(rule=1.0)
    axis = error_axis(frame, "error / bound (−)")
    kept = table(frame.drop(columns=["seconds", "begins", "slowest", "start"]))
    chart = rows(kept, gallery.ordered(cells), axis, ("excess", "low", "high"), by="quantity", tiers=tiers_of(gallery))
    header = alt.Header(labelExpr="datum.value + ' dB'", labelAnchor="middle")
    facet = alt.Column("SNR:Q").sort("descending").header(header)
    middle = frame.groupby("method").excess.median().drop(map(title, REFERENCES), errors="ignore")
    return Picture(
        "forest",
        chart.properties(width=70, height=alt.Step(5)).facet(column=facet, spacing=8),
        f"{(middle <= NEAR).sum()} of {len(middle)} methods are within {NEAR:g} times the best that the data allow. "
        "Root mean square error of the fits that succeeded over the Cramér-Rao bound, with its 95 % bootstrap interval "
        f"({cells[0].system}, initial state {start}; {replicates(cells)} replicates). At the line at 1 no unbiased "
        "method can do better; a triangle is beyond the edge. The count is by the median over columns and quantities. "
        f"{_spoken(gallery)}",
    )


def _most_replicates(gallery: Gallery) -> list[Result]:
    """The main scenario under the seed with most fits: intervals are tested on one of its own."""

    def alike(cell: Result) -> str:
        return json.dumps({**json.loads(cell.series), "seed": 0}, sort_keys=True)

    cells = [cell for cell in gallery.cells if alike(cell) == alike(gallery.main[0])]
    scenes = [gallery.scene(own, "unknown") for own in group(cells, lambda cell: cell.seed).values()]
    return max(scenes, key=lambda own: (sum(cell.successful(f"{K}_pit").size for cell in own), -own[0].seed))


def draw_coverage(gallery: Gallery) -> Picture:
    """A column a nominal level: how often the intervals of that level held the truth."""
    cells = [cell for cell in _most_replicates(gallery) if cell.label != "prior"]
    cells = [cell for cell in cells if cell.successful(f"{K}_pit").size >= FEWEST]
    if not cells:
        raise Nothing(f"no method with intervals of k/m over {FEWEST} replicates or more is stored")
    frame = pd.DataFrame(
        [
            (title(cell.label), NAMES[name], level, cell.n_ok, *(100.0 * part for part in held(cell, name, level)))
            for cell in cells for level in LEVELS for name in (K, C, MOTION)
        ], columns=["method", "quantity", "rule", "fits", "held", "low", "high"]
    ).dropna()  # fmt: skip

    def axis(column: str) -> alt.X:
        scale, ticks = alt.Scale(domain=[0, 100], clamp=True), alt.Axis(values=[0, *LEVELS])
        return alt.X(f"{column}:Q").scale(scale).axis(ticks).title("held the truth (%)")

    chart = rows(table(frame), gallery.ordered(cells), axis, ("held", "low", "high"), by="quantity")
    header = alt.Header(labelExpr="'intervals of ' + datum.value + ' %'", labelAnchor="middle")
    judged = frame[(frame["rule"] == 95) & (frame.quantity == NAMES[K]) & ~frame.method.isin(map(title, REFERENCES))]
    right = ((judged.low <= 95) & (judged.high >= 95)).sum()
    return Picture(
        "coverage",
        chart.properties(width=120, height=alt.Step(4)).facet(column=alt.Column("rule:Q").header(header), spacing=8),
        f"The 95 % intervals of k/m hold the truth as often as they say in {right} of {len(judged)} methods. Measured "
        f"share of the intervals that held it ({where(cells[0])}, seed {cells[0].seed}; {replicates(cells)} "
        "replicates), with its 95 % interval (Wilson). Left of the line, the nominal level, a method is too sure of "
        "itself, right of it too modest. Displacement: the mean share of the record inside the method's band.",
    )


def held(cell: Result, quantity: str, level: int) -> tuple[float, float, float]:
    """Return the share of equal-tailed intervals of a level (%) that held the truth, and its 95 % interval.

    An interval holds the truth where the distribution's level there is within half the interval's of a half.
    """
    if quantity == MOTION:
        inside = cell.successful(f"band_inside_{level}")
        return (float(inside.mean()) if inside.size else math.nan,) * 3
    hits = np.abs(cell.successful(f"{quantity}_pit") - 0.5) <= level / 200.0 + 1e-12
    return (float(hits.mean()), *wilson_interval(int(hits.sum()), hits.size)) if hits.size else (math.nan,) * 3


def error_axis(every: pd.DataFrame, name: str) -> Across:
    """Return the axis of errors over bounds."""
    low, high = max(NEAREST, 0.9 * min(every.low.min(), 1.0)), min(FARTHEST, 1.15 * max(every.high.max(), 2.0))
    return partial(log_axis, low=low, high=high, name=name)


def beside(
    frame: pd.DataFrame, order: Sequence[str], height: float, limits: pd.DataFrame | None = None,
    width: float = 150.0, **kept: Any,
) -> Any:  # fmt: skip
    """Return time on the left and error over bound on the right, of the same rows; ``limits`` has those of the axes."""
    every = frame if limits is None else limits
    time = partial(log_axis, low=0.8 * every.begins.min(), high=1.25 * every.slowest.max(), name="processor time (s)")
    error = error_axis(every, "error of k/m / bound (−)")
    seconds, excess = table(frame.assign(rule=math.nan)), table(frame.assign(rule=1.0))
    left = rows(seconds, order, time, ("seconds", "begins", "slowest"), **kept)
    right = rows(excess, order, error, ("excess", "low", "high"), labels=False, **kept)
    panels = (panel.properties(width=width, height=alt.Step(height)) for panel in (left, right))
    return alt.hconcat(*panels, spacing=8)


def draw_time(gallery: Gallery) -> Picture:
    """Time beside error over the bound, by tier, within a tier the fastest first."""
    level = gallery.scene(gallery.main)[0].snr_db
    cells = [cell for cell in gallery.main if cell.snr_db == level and not cell.is_reference]
    frame, tiers = excesses(cells, (K,)), tiers_of(gallery)
    seconds = frame.groupby("method").seconds.max()
    order = sorted(seconds.index, key=lambda name: (tiers.get(name, 99), seconds[name]))
    starts = sorted(set(frame.start))
    chart = beside(frame.drop(columns=["SNR", "quantity"]), order, 5 if len(starts) > 1 else 8, by="start", tiers=tiers)
    first = [name for name in order if tiers.get(name, 99) == tiers.get(order[0], 99)]
    slowest = float(f"{seconds[first].max() / seconds[first].min():.2g}")
    return Picture(
        "accuracy_against_time",
        chart,
        f"{order[0]} is the fastest of {len(first)} methods of the first tier; the slowest of them takes "
        f"{slowest:,g} times as long. Left: processor time of a fit ({cells[0].system}, {level:g} dB), the median and "
        "a line to the slowest, often the first of a process. Right: root mean square error of k/m over its Cramér-Rao "
        f"bound, with its 95 % interval. {_spoken(gallery)} Within a tier the fastest comes first.",
    )


def draw_family(gallery: Gallery) -> Picture:
    """A part for each factor and base: when each variant's training is as good as the oracle, and how good at last."""
    name = next(name for name in table_experiments() if Experiment(name).table.get("form") == "family")
    family = family_of(experiment_frame(name, gallery.store))
    oracle = next((member.stored_cell(PLACE) for member in family.variants if member.method == "oracle"), None)
    compared = [own for own in (family.section(*which) for which in COMPARED) if own]
    frames = {f"{own.heading}, {own.base}": trainings(own, oracle) for own in compared}
    frames = {heading: frame for heading, frame in frames.items() if len(frame)}
    if not frames:
        raise Nothing("no training of a family is stored")
    every = pd.concat(frames.values())
    parts = [
        beside(frame, frame.method.tolist(), 8, limits=every).properties(title=alt.Title(heading, frame="group"))
        for heading, frame in frames.items()
    ]
    return Picture(
        family.method,
        alt.vconcat(*parts, spacing=8),
        f"{every.seconds.notna().sum()} of {len(every)} trainings become as good as the oracle. Left: the training, "
        f"and as a marker the moment from which on the error of k/m stays within {ORACLE:g} times that of the oracle "
        "on the same data. Right: root mean square error at the end over the "
        f"Cramér-Rao bound, in a part on the same data sets ({PLACE[0]:g} dB, initial state {PLACE[1]}; "
        f"{every.n.min()} to {every.n.max()}), so that all are above 1 where these happen to be hard. In a part, each "
        "differs in one thing from its base; the least error comes first.",
    )


def trainings(section: Section, oracle: Result | None) -> pd.DataFrame:
    """Return when each training of a section is as good as the oracle and when it ends (s), and its error at the end.

    The error is over the bound, of the first data sets, which all have.
    """
    n, lines = section.common(PLACE), []
    for row in section.rows:
        cell = row.stored_cell(PLACE)
        if cell and cell.successful("training_s").size:
            seconds, error = oracle_seconds(cell, oracle), root_mean_square(cell.successful(METRICS[K], n))
            end, excess = float(cell.successful("training_s").max()), error / cell.bound(METRICS[K])
            lines.append((row.title, n, seconds if seconds <= end else math.nan, end, excess, excess, excess))
    frame = pd.DataFrame(lines, columns=["method", "n", "seconds", "slowest", "excess", "low", "high"])
    return frame.assign(begins=MOMENTS[0]).sort_values(["excess", "slowest"])
