"""Figures with a row per method: error over the bound, coverage, time, and the family of PINNs."""

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
from bench.reporting.frame import Result, experiment_frame, group, share, table_experiments
from bench.reporting.labels import title
from bench.reporting.pictures.gallery import METRICS, MOTION, C, Gallery, K, replicates, where
from bench.reporting.pictures.style import Nothing, Picture, layered, logarithmic, table
from bench.reporting.tables.family import NEAR as ORACLE
from bench.reporting.tables.family import oracle_seconds
from bench.reporting.tables.pooling import root_mean_square
from bench.scoring.statistics import counts, middle_95
from bench.scoring.traces import MOMENTS

NEAR = 1.25
"""Largest error over bound of a method that counts as near the bound."""
FARTHEST, NEAREST = 100.0, 0.3
"""Range of errors over the bound; values outside are drawn at the edge."""
MOST = 6
"""Largest number of noise levels."""
FEWEST = 20
"""Smallest number of replicates for a coverage."""
LEVELS = (50, 80, 95)
NAMES = {K: "k/m", C: "c/m", MOTION: "displacement"}
"""Names of the quantities in figures."""
COMPARED = (("optimizer", 0), ("optimizer", 1), ("weighting", 0), ("architecture", 0))
"""Parts of the figure of the family: the varied setting, and the number of the base."""
Across = Callable[[str], alt.X]
"""Function that returns the axis of a column."""


def rows(
    frame: pd.DataFrame, order: Sequence[str], across: Across, columns: tuple[str, str, str], *, by: str = "",
    tiers: Mapping[str, int] | None = None, labels: bool = True,
) -> Any:  # fmt: skip
    """Draw a row per method with a marker and a line between two ends.

    Args:
        frame: The data, with the columns ``method`` and ``rule`` (abscissa of a line across all rows).
        order: The methods, from top to bottom.
        across: Returns the axis of a column; values beyond its limits are drawn as triangles at the edge.
        columns: Columns of the marker and of both ends of the line.
        by: Column of the colours, which are drawn side by side in each row.
        tiers: Tier of each method; a thicker line is drawn above the first method of each tier.
        labels: Whether the rows have labels.
    """
    first = [next(members) for _, members in groupby(order, lambda name: (tiers or {}).get(name, 0))]
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

    Failed fits (errors that are not finite) are left out; NaNs for fewer than two.
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
    frame = pd.DataFrame(lines, columns=columns).dropna().assign(begins=lambda data: data.seconds)
    if frame.empty:
        raise Nothing("no method with an error and a bound over two replicates or more is stored")
    return frame


def _seconds(cell: Result) -> tuple[float, float]:
    """Return the median and the longest time (s) of the successful fits."""
    seconds = cell.cpu_s[cell.ok]
    return (float(np.median(seconds)), float(seconds.max())) if seconds.size else (math.nan, math.nan)


def tiers_of(gallery: Gallery) -> dict[str, int]:
    """Return the tier of each method by title; 99 for methods without a tier."""
    return {title(label): tier or 99 for label, tier in gallery.tiers.items()}


def _tier_sentence(gallery: Gallery) -> str:
    """Describe the order of the rows, for captions."""
    tiers = list(gallery.tiers.values())
    return (
        f"Methods are sorted by tier of the ranking over these scenarios ({tiers.count(1)} of {len(tiers)} are in the "
        "first), with a thicker line between tiers; methods that do not serve all scenarios come last."
    )


def draw_forest(gallery: Gallery) -> Picture:
    """Draw the error over the bound with its interval, one column per noise level."""
    initial_state = gallery.scene(gallery.main, "unknown")[0].initial_state
    cells = [cell for cell in gallery.main if cell.initial_state == initial_state and cell.label != "prior"]
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
        f"{(middle <= NEAR).sum()} of {len(middle)} methods are within {NEAR:g} times the Cramér-Rao bound (median "
        "over columns and quantities). Root mean square error of the successful fits over the bound, with its 95 % "
        f"bootstrap interval ({cells[0].system}, initial state {initial_state}; {replicates(cells)} replicates). No "
        f"unbiased method can be left of the line at 1; triangles lie beyond the edge. {_tier_sentence(gallery)}",
    )


def _most_replicates(gallery: Gallery) -> list[Result]:
    """Return the main scenario with the seed that has most fits; calibration has a seed of its own."""

    def without_seed(cell: Result) -> str:
        return json.dumps({**json.loads(cell.series), "seed": 0}, sort_keys=True)

    cells = [cell for cell in gallery.cells if without_seed(cell) == without_seed(gallery.main[0])]
    scenes = [gallery.scene(members, "unknown") for members in group(cells, lambda cell: cell.seed).values()]
    return max(scenes, key=lambda scene: (sum(cell.successful(f"{K}_pit").size for cell in scene), -scene[0].seed))


def draw_coverage(gallery: Gallery) -> Picture:
    """Draw the coverage of the intervals, one column per nominal level."""
    cells = [cell for cell in _most_replicates(gallery) if cell.label != "prior"]
    cells = [cell for cell in cells if cell.successful(f"{K}_pit").size >= FEWEST]
    if not cells:
        raise Nothing(f"no method with intervals of k/m over {FEWEST} replicates or more is stored")
    frame = pd.DataFrame(
        [
            (title(cell.label), NAMES[name], level, cell.n_ok, *(100.0 * part for part in coverage(cell, name, level)))
            for cell in cells for level in LEVELS for name in (K, C, MOTION)
        ], columns=["method", "quantity", "rule", "fits", "coverage", "low", "high"]
    ).dropna()  # fmt: skip

    def axis(column: str) -> alt.X:
        scale, ticks = alt.Scale(domain=[0, 100], clamp=True), alt.Axis(values=[0, *LEVELS])
        return alt.X(f"{column}:Q").scale(scale).axis(ticks).title("coverage (%)")

    chart = rows(table(frame), gallery.ordered(cells), axis, ("coverage", "low", "high"), by="quantity")
    header = alt.Header(labelExpr="datum.value + ' % intervals'", labelAnchor="middle")
    judged = frame[(frame["rule"] == 95) & (frame.quantity == NAMES[K]) & ~frame.method.isin(map(title, REFERENCES))]
    right = ((judged.low <= 95) & (judged.high >= 95)).sum()
    return Picture(
        "coverage",
        chart.properties(width=120, height=alt.Step(4)).facet(column=alt.Column("rule:Q").header(header), spacing=8),
        f"The 95 % intervals of k/m are calibrated for {right} of {len(judged)} methods. Coverage: share of the "
        f"intervals that contain the true value ({where(cells[0])}, seed {cells[0].seed}; {replicates(cells)} "
        "replicates), with its 95 % interval (Wilson). Left of the line (the nominal level) a method is overconfident, "
        "right of it underconfident. Displacement: mean share of the record inside the method's band.",
    )


def coverage(cell: Result, quantity: str, level: int) -> tuple[float, float, float]:
    """Return the coverage of equal-tailed intervals of a level (%), with its 95 % interval."""
    if quantity == MOTION:
        inside = cell.successful(f"band_inside_{level}")
        return (float(inside.mean()) if inside.size else math.nan,) * 3
    return share(np.abs(cell.successful(f"{quantity}_pit") - 0.5) <= level / 200.0 + 1e-12)


def error_axis(every: pd.DataFrame, name: str) -> Across:
    """Return a function for axes of errors over bounds."""
    low, high = max(NEAREST, 0.9 * min(every.low.min(), 1.0)), min(FARTHEST, 1.15 * max(every.high.max(), 2.0))
    return partial(log_axis, low=low, high=high, name=name)


def time_and_error(
    frame: pd.DataFrame, order: Sequence[str], height: float, limits: pd.DataFrame | None = None,
    width: float = 150.0, **options: Any,
) -> Any:  # fmt: skip
    """Draw time on the left and error over bound on the right; ``limits`` are the data that determine the axes."""
    every = frame if limits is None else limits
    time = partial(log_axis, low=0.8 * every.begins.min(), high=1.25 * every.slowest.max(), name="processor time (s)")
    error = error_axis(every, "error of k/m / bound (−)")
    seconds, excess = table(frame.assign(rule=math.nan)), table(frame.assign(rule=1.0))
    left = rows(seconds, order, time, ("seconds", "begins", "slowest"), **options)
    right = rows(excess, order, error, ("excess", "low", "high"), labels=False, **options)
    panels = (panel.properties(width=width, height=alt.Step(height)) for panel in (left, right))
    return alt.hconcat(*panels, spacing=8)


def draw_time(gallery: Gallery) -> Picture:
    """Draw time and error over the bound, sorted by tier, within a tier by time."""
    level = gallery.scene(gallery.main)[0].snr_db
    cells = [cell for cell in gallery.main if cell.snr_db == level and not cell.is_reference]
    frame, tiers = excesses(cells, (K,)), tiers_of(gallery)
    seconds = frame.groupby("method").seconds.max()
    order = sorted(seconds.index, key=lambda name: (tiers.get(name, 99), seconds[name]))
    starts = sorted(set(frame.start))
    height = 5 if len(starts) > 1 else 8
    chart = time_and_error(frame.drop(columns=["SNR", "quantity"]), order, height, by="start", tiers=tiers)
    first = [name for name in order if tiers.get(name, 99) == tiers.get(order[0], 99)]
    slowest = float(f"{seconds[first].max() / seconds[first].min():.2g}")
    return Picture(
        "accuracy_against_time",
        chart,
        f"{order[0]} is the fastest of {len(first)} methods of the first tier; the slowest of them takes "
        f"{slowest:,g} times as long. Left: processor time per fit ({cells[0].system}, {level:g} dB), the median and "
        "a line up to the slowest fit, often the first of a process. Right: root mean square error of k/m over its "
        f"Cramér-Rao bound, with its 95 % interval. {_tier_sentence(gallery)} Within a tier the fastest comes first.",
    )


def draw_family(gallery: Gallery) -> Picture:
    """Draw, for each factor and base, when each training reaches the oracle's accuracy, and its final error."""
    name = next(name for name in table_experiments() if Experiment(name).table.get("form") == "family")
    family = family_of(experiment_frame(name, gallery.store))
    oracle = next((member.stored_cell(PLACE) for member in family.variants if member.method == "oracle"), None)
    compared = [section for section in (family.section(*which) for which in COMPARED) if section]
    frames = {f"{section.heading}, {section.base}": trainings(section, oracle) for section in compared}
    frames = {heading: frame for heading, frame in frames.items() if len(frame)}
    if not frames:
        raise Nothing("no training of a family is stored")
    every = pd.concat(frames.values())
    parts = [
        time_and_error(frame, frame.method.tolist(), 8, limits=every).properties(
            title=alt.Title(heading, frame="group")
        )
        for heading, frame in frames.items()
    ]
    return Picture(
        family.method,
        alt.vconcat(*parts, spacing=8),
        f"{every.seconds.notna().sum()} of {len(every)} trainings reach the accuracy of the oracle. Left: duration of "
        f"the training, with a marker at the time after which the error of k/m stays within {ORACLE:g} times that of "
        "the oracle on the same data. Right: final root mean square error over the Cramér-Rao bound, on the same data "
        f"sets within a part ({PLACE[0]:g} dB, initial state {PLACE[1]}; {every.n.min()} to {every.n.max()}), so all "
        "are above 1 if these have large errors by chance. In each part the trainings differ from the base in one "
        "setting; the smallest error comes first.",
    )


def trainings(section: Section, oracle: Result | None) -> pd.DataFrame:
    """Return when each training of a section reaches the oracle's accuracy and when it ends (s), and its final error.

    The error is relative to the bound, on the data sets that all trainings have in common.
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
