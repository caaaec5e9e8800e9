"""One style for every picture: a chart of Altair's in; a PNG file and an SVG file out.

A length of 1 is a point (1/72 inch), so that no letter is below 7 points. Rows or panels name the methods; colours tell
what is drawn of each.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import altair as alt
import pandas as pd
import vl_convert

from bench.reporting.pictures.png import RESOLUTION, packed
from bench.reporting.pictures.theme import FULL, THEME
from bench.reporting.whole_file import write

ONE = alt.InlineData([{}])
"""The data of a mark that stands once in each panel."""
SHORT = 2.0
"""Highest over lowest value of a scale on which a logarithm would not be seen."""
DIGITS = 6
"""Significant digits of the numbers in a specification."""


class Nothing(Exception):
    """Why a picture cannot be drawn from a store: a sentence."""


@dataclass(frozen=True, eq=False)
class Picture:
    """A chart, what its files are called, and a caption whose first sentence says what is seen."""

    name: str
    chart: Any
    caption: str
    width: float = FULL


@cache
def register_font() -> None:
    """Draw with the file of the font that comes with matplotlib: the same on every machine."""
    import matplotlib

    vl_convert.register_font_directory(str(Path(matplotlib.get_data_path()) / "fonts" / "ttf"))


def table(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a chart's data with numbers of few digits: the same text on every machine."""

    def short(value: Any) -> Any:
        return float(f"{value:.{DIGITS}g}") if isinstance(value, float) and math.isfinite(value) else value

    return frame.map(short)


def layered(data: pd.DataFrame, *charts: Any) -> Any:
    """Return charts of the same data in one panel, lowest first; those with data of their own stand in each panel."""
    layers = [chart.copy(deep=False) for chart in charts]
    for layer in layers:
        if layer.data is data:
            layer.data = alt.Undefined  # a copy of its own would not be divided into panels
    return alt.LayerChart(layer=layers, data=data)


def logarithmic(low: float, high: float) -> tuple[alt.Scale, alt.Axis]:
    """Return a logarithmic scale between two limits, with ticks at 1, 2, 5, 10 where it is short, or decades.

    Where these are hardly apart, a linear one, which looks the same.
    """
    if high / low < SHORT:
        return alt.Scale(domain=[low, high], nice=False, zero=False), alt.Axis(tickCount=4, grid=True)
    steps = (1.0, 2.0, 5.0) if high / low < 100.0 else (1.0,)
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    ticks = [step * 10.0**decade for decade in decades for step in steps if low <= step * 10.0**decade <= high]
    scale = alt.Scale(type="log", domain=[low, high], clamp=True, nice=False)
    return scale, alt.Axis(values=ticks, format="~g", grid=True)


def specification(chart: Any, width: float = FULL) -> dict[str, Any]:
    """Return the chart as Vega-Lite, in our style, its panels as wide as makes the whole picture ``width`` wide."""
    register_font()
    with alt.data_transformers.enable("default", max_rows=None):
        spec = chart.properties(padding=2).to_dict() | {"config": THEME}
    # the whole is nearly a constant (names, spaces) and a multiple of the panels' widths: the secant method
    last, factor = 1.5, 2.0
    before, whole = (drawn_width(_scaled(spec, own)) for own in (last, factor))
    for _ in range(4):
        if abs(whole - width) <= 1.0 or whole == before:
            break
        last, factor = factor, factor + (width - whole) * (factor - last) / (whole - before)
        before, whole = whole, drawn_width(_scaled(spec, factor))
    return dict(_scaled(spec, factor))


def _scaled(spec: Any, factor: float) -> Any:
    """Return the specification with all panels' widths multiplied."""
    if isinstance(spec, list):
        return [_scaled(part, factor) for part in spec]
    if not isinstance(spec, dict):
        return spec
    kept = {name: part for name, part in spec.items() if name in ("config", "datasets")}
    rest = {name: _scaled(part, factor) for name, part in spec.items() if name not in kept}
    width = spec.get("width")
    return rest | kept | ({"width": factor * width} if isinstance(width, int | float) else {})


def drawn_width(spec: dict[str, Any]) -> float:
    """Return how wide a specification is drawn."""
    match = re.search(r'width="([\d.]+)"', vl_convert.vegalite_to_svg(spec))
    assert match is not None
    return float(match.group(1))


def save(picture: Picture, folder: Path, svg: Path | None = None) -> list[Path]:
    """Write the PNG file, and into a further folder, where one is given, the SVG file."""
    spec = specification(picture.chart, picture.width)
    paths = [folder / f"{picture.name}.png"]
    write(paths[0], packed(vl_convert.vegalite_to_png(spec, ppi=RESOLUTION), picture.caption), folder)
    if svg is not None:
        paths.append(svg / f"{picture.name}.svg")
        write(paths[-1], vl_convert.vegalite_to_svg(spec), svg, "svg")
    return paths
