"""The picture of growth: processor time against data sets, samples and masses, with the exponents at the lines."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import altair as alt
import pandas as pd

from bench.reporting.labels import title
from bench.reporting.pictures.style import Picture, layered, logarithmic, save, table
from tests.studies.engines.results import LARGE, Growth
from tests.studies.engines.rows import CURVES

TITLES = {"together": "data sets, all together", "samples": "samples", "masses": "masses"}


def stored_growths(table: pd.DataFrame) -> list[Growth]:
    """The curves of a table of numbers as ``page.tidy`` makes it, without what ended them."""
    found = []
    for curve in CURVES:
        own = table[(table.part == "growth") & (table["name"] == f"{curve.method} {curve.axis}")]
        if len(own):
            found.append(Growth(curve, tuple(own["size"].astype(int)), tuple(own.seconds.astype(float))))
    return found


def picture(growths: Sequence[Growth], folder: Path) -> list[Path]:
    """Draw the curves, one panel for each kind of size."""
    parts = [
        pd.DataFrame({"panel": TITLES[growth.curve.axis], "method": title(growth.curve.method), "n": growth.sizes,
                      "seconds": growth.seconds})
        for growth in growths
    ]  # fmt: skip
    frame = table(pd.concat(parts))
    scale, ticks = logarithmic(0.8 * frame.seconds.min(), 1.25 * frame.seconds.max())
    x = (
        alt.X("n:Q")
        .scale(type="log", nice=False, padding=6)
        .axis(tickCount=4, format="~g", grid=False)
        .title("number n (−)")
    )
    y = alt.Y("seconds:Q").scale(scale).axis(ticks).title("time (s)")
    hue = alt.Color("method:N").sort(list(dict.fromkeys(frame.method))).legend(columns=4)
    chart = alt.Chart(frame).encode(x, y, hue, tooltip=list(frame.columns))
    layers = layered(frame, chart.mark_line(), chart.mark_point(filled=True, size=14, opacity=1))
    drawn = layers.properties(width=120, height=150)
    facet = alt.Column("panel:N").sort(list(TITLES.values()))
    faceted = drawn.facet(column=facet, spacing=10).resolve_scale(x="independent")
    return save(Picture("engines_scaling", faceted, caption(growths)), folder)


def caption(growths: Sequence[Growth]) -> str:
    """Return the caption of the picture."""
    known = [growth for growth in growths if len(growth.sizes) > 1]
    steep = [growth for growth in known if growth.exponent > LARGE]
    powers = "; ".join(f"{title(g.curve.method)} with {g.curve.axis} {g.exponent:.2f}" for g in known)
    return (
        f"Time grows faster than the problem on {len(steep)} of {len(known)} lines. Processor time against the number "
        "of data sets solved together, of samples and of masses; left the time of all data sets together, else that "
        f"of a fit. The power of n with which the upper half of a line grows (above {LARGE:g} counts as faster): "
        f"{powers}."
    )
