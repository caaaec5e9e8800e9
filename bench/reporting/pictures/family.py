"""How the variants of a family get to their answer: the error of k/m over the bound against processor seconds."""

from __future__ import annotations

import math
from typing import Any

import altair as alt
import numpy as np
import pandas as pd

from bench.config.experiment import Experiment
from bench.reporting.family import PLACE, Section, any_stored, family_of
from bench.reporting.figures.beside import spread
from bench.reporting.figures.gallery import Gallery, Nothing, Picture, where
from bench.reporting.frame import ERROR, Frame, Result, experiment_frame, table_experiments
from bench.reporting.pictures.style import ONE, layered, plain, table
from bench.reporting.tables.family import STIFFNESS as GROUP
from bench.reporting.tables.family import moment_score
from bench.reporting.tables.pooling import root_mean_square
from bench.scoring.traces import MOMENTS

PANELS = (("optimizer", 0), ("optimizer", 1), ("weighting", 0), ("architecture", 0))
"""The setting that a panel varies, and around which base."""
NEAR = 1.5
"""A training is said to be near the bound whose error at the end is at most so many times the bound."""
LINE = 9.0
"""Height of a name beside a panel."""


def draw_family(gallery: Gallery) -> Picture:
    """A panel a factor and base, a line a row, its name at its end."""
    for name in table_experiments():
        if Experiment(name).table.get("form") == "family":
            return family_picture(experiment_frame(name, gallery.store))
    raise Nothing("no experiment has a family")


def family_picture(frame: Frame) -> Picture:
    """The picture of an experiment's family; raises Nothing where no training is stored."""
    if not any_stored(frame):
        raise Nothing("no training of a family is stored")
    family = family_of(frame)
    sections = [section for setting, base in PANELS if (section := family.section(setting, base))]
    found = [(section, own) for section in sections if len(own := curves(section))]
    if not found:
        raise Nothing("no training of a family is stored")
    every = pd.concat([own for _, own in found])
    seconds = 0.8 * every.seconds.min(), 1.5 * every.end.max()
    ratios = 0.8 * min(1.0, every.ratio.min()), 1.25 * max(1.0, every.ratio.max())
    height = max(110.0, LINE * max(own["name"].nunique() for _, own in found) + 10.0)
    panels = [
        _panel(own, seconds, ratios, height).properties(
            title=alt.Title(f"{section.heading}, {section.base}", orient="top", anchor="start")
        )
        for section, own in found
    ]
    chart = alt.concat(*panels, columns=2, spacing=14).resolve_scale(color="independent")
    ends = [float(own.ratio.iloc[-1]) for _, part in found for _, own in part.groupby("name")]
    scene = next(one for section, _ in found for row in section.rows if (one := row.at(PLACE)))
    axes = "error of k/m / bound (−) over processor time (s)"
    return Picture(
        chart.properties(title=alt.Title(axes, anchor="middle")),
        f"{sum(end <= NEAR for end in ends)} of {len(ends)} trainings end within {NEAR:g} times the bound. In a panel, "
        f"all on the same data sets ({where(scene)}): root mean square error of k/m of the answer so far over its "
        "Cramér-Rao bound (grey line) against processor time. A dot is where the longest training ended; black is the "
        "base, from which each of the others differs in one thing. Names stand in the order of the errors at the end.",
        family.method,
    )


def curves(section: Section) -> pd.DataFrame:
    """The error of k/m over the bound at moments (s) of each row that is stored with the way of its training.

    All on the same data sets. ``end``: when the longest of a row's trainings ended, which is its last moment.
    """
    n, parts = section.common(PLACE), []
    for row in section.rows:
        one = row.at(PLACE)
        if one and one.successful("training_s").size:
            seconds, ratios = errors(one, n)
            end = float(one.successful("training_s").max())
            if seconds.size:
                inside = seconds < end
                points = {"seconds": [*seconds[inside], end], "ratio": [*ratios[inside], ratios[-1]]}
                parts.append(pd.DataFrame(points).assign(name=row.title, base=row.base, end=end))
    return pd.concat(parts) if parts else pd.DataFrame()


def errors(one: Result, n: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """The moments (s) at which every successful fit has an answer, and the error of k/m over the bound there.

    With ``n``, of the first n replicates alone.
    """
    bound, ok = one.bound(GROUP + ERROR), one.ok[:n]
    values = np.array([root_mean_square(one.scores(moment_score(moment))[:n][ok]) / bound for moment in MOMENTS])
    known = np.isfinite(values) & (values > 0)
    return np.array(MOMENTS)[known], values[known]


def _panel(own: pd.DataFrame, seconds: tuple[float, float], ratios: tuple[float, float], height: float) -> Any:
    """The lines of a section, and right of them the name of each, as near its end as the others let it."""
    ends = own.groupby("name", sort=False).last().reset_index()
    low, high = np.log(ratios)
    sizes = np.full(len(ends), LINE / height)
    places = spread(((np.log(ends.ratio) - low) / (high - low)).to_numpy(), sizes)
    frame = table(own.merge(pd.DataFrame({"name": ends["name"], "place": np.exp(low + places * (high - low))})))
    chart = alt.Chart(frame).transform_calculate(edge=f"{seconds[1]:.6g}")
    log = [alt.Scale(type="log", domain=list(limits), nice=False) for limits in (seconds, ratios)]
    x = alt.X("seconds:Q").scale(log[0]).axis(values=plain(*seconds), format="~g").title(None)
    y = alt.Y("ratio:Q").scale(log[1]).axis(values=plain(*ratios), format="~g").title(None)
    hue = alt.Color("name:N").sort(ends["name"].tolist()).legend(None)
    right, place = {"x": alt.value("width")}, alt.Y("place:Q").title(None)
    last = chart.transform_filter("datum.seconds == datum.end")
    layers = [last.mark_text(align="left", dx=10).encode(place, text="name:N", **right)]
    for which, style, colour in (("!datum.base", "series", hue), ("datum.base", "truth", alt.Undefined)):
        line, end = (part.transform_filter(which).encode(color=colour) for part in (chart, last))
        beside = end.mark_rule(style=style, strokeWidth=0.6, x2Offset=8)
        layers += [
            line.mark_line(style=style, strokeWidth=1.2).encode(x, y, tooltip=["name", "seconds", "ratio"]),
            end.mark_point(style=style, filled=True, size=10, opacity=1).encode(x, y),
            end.mark_rule(style=style, strokeWidth=0.4).encode(x, y, x2="edge:Q"),
            beside.encode(y, x2=alt.value("width"), y2="place:Q", **right),
        ]
    return layered(frame, alt.Chart(ONE).mark_rule(style="quiet").encode(y=alt.datum(1)), *layers).properties(
        width=130, height=math.ceil(height)
    )
