"""One style for every picture: a chart of Altair's in; a PNG file, an SVG file or an interactive specification out.

A length of 1 is a point (1/72 inch), so that no letter is below 7 points. Rows or panels name the methods; colours tell
what is drawn of each.
"""

from __future__ import annotations

import io
import json
import math
import re
import textwrap
from functools import cache
from pathlib import Path
from typing import Any

import altair as alt
import pandas as pd
import vl_convert

from bench.reporting.figures.png import MOST_BYTES, RESOLUTIONS, packed
from bench.reporting.pictures.theme import FULL, HALF, SERIES, SMALL, theme  # noqa: F401 - taken from here
from bench.reporting.whole_file import write

ONE = alt.InlineData([{}])
"""The data of a mark that stands once in each panel."""
SEARCHES = 6
"""Drawings at most that find the width of the panels."""
DIGITS = 6
"""Significant digits of the numbers in a specification."""


@cache
def register_font() -> None:
    """Draw with the file of the font that comes with matplotlib: the same on every machine."""
    import matplotlib

    vl_convert.register_font_directory(str(Path(matplotlib.get_data_path()) / "fonts" / "ttf"))


def table(frame: pd.DataFrame) -> pd.DataFrame:
    """A chart's data with numbers of few digits: the same text on every machine."""

    def short(value: Any) -> Any:
        return float(f"{value:.{DIGITS}g}") if isinstance(value, float) and math.isfinite(value) else value

    return frame.map(short)


def layered(data: pd.DataFrame, *charts: Any) -> Any:
    """Charts of the same data in one panel, lowest first; those with data of their own stand in each panel."""
    layers = []
    for chart in charts:
        layer = chart.copy(deep=False)
        if layer.data is data:
            layer.data = alt.Undefined
        layers.append(layer)
    return alt.LayerChart(layer=layers, data=data)


def in_lines(name: str, letters: int) -> str:
    """A name in lines of so many letters at most."""
    return textwrap.fill(name, letters)


def panel_names(**kept: Any) -> alt.Header:
    """The header of panels whose names may have several lines."""
    return alt.Header(labelAnchor="start", labelExpr="split(datum.label, '\\n')", **kept)


def plain(low: float, high: float) -> list[float]:
    """Ticks of a logarithmic axis: 1, 2, 5, 10 where it is short, or decades."""
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    steps = (1.0, 2.0, 5.0) if high / low < 100.0 else (1.0,)
    return [step * 10.0**decade for decade in decades for step in steps if low <= step * 10.0**decade <= high]


def specification(chart: Any, width: float, dark: bool = False) -> dict[str, Any]:
    """The chart as Vega-Lite, in our style, its panels as wide as makes the whole picture ``width`` wide."""
    register_font()
    with alt.data_transformers.enable("default", max_rows=None):
        spec = chart.properties(padding=2).to_dict() | {"config": theme(dark)}
    # the whole is nearly a constant (names, spaces) and a multiple of the panels' widths: regula falsi
    factor, whole = 1.0, drawn_width(spec)
    following = width / whole
    for _ in range(SEARCHES):
        if abs(whole - width) <= 1.0:
            break
        before, factor = (factor, whole), following
        whole = drawn_width(_scaled(spec, factor))
        if whole == before[1]:  # the legend is wider than the panels
            following = 1.5 * factor
            continue
        following = factor + (width - whole) * (factor - before[0]) / (whole - before[1])
    return dict(_scaled(spec, factor))


def _scaled(spec: Any, factor: float) -> Any:
    """The specification with all panels' widths multiplied."""
    if isinstance(spec, list):
        return [_scaled(part, factor) for part in spec]
    if not isinstance(spec, dict):
        return spec
    kept = ("config", "datasets")
    return {
        name: factor * part
        if name == "width" and isinstance(part, int | float)
        else (part if name in kept else _scaled(part, factor))
        for name, part in spec.items()
    }


def drawn_width(spec: dict[str, Any]) -> float:
    """How wide a specification is drawn."""
    match = re.search(r'width="([\d.]+)"', vl_convert.vegalite_to_svg(spec))
    assert match is not None
    return float(match.group(1))


def png_of(spec: dict[str, Any], caption: str) -> bytes:
    """The PNG file of a specification, with its caption, of few colours."""
    from PIL import Image

    for dpi in RESOLUTIONS:
        with Image.open(io.BytesIO(vl_convert.vegalite_to_png(spec, ppi=dpi))) as image:
            data = packed(image, dpi, caption)
        if len(data) <= MOST_BYTES:
            break
    return data


def save_chart(spec: dict[str, Any], folder: Path, name: str, caption: str, svg: Path | None = None) -> list[Path]:
    """Write the PNG file; into a further folder, where one is given, SVG and the interactive specification."""
    paths = [folder / f"{name}.png"]
    write(paths[0], png_of(spec, caption), folder)
    if svg is not None:
        text = json.dumps(spec | {"description": caption}, ensure_ascii=False, separators=(",", ":"))
        for suffix, content in (("svg", vl_convert.vegalite_to_svg(spec)), ("vl.json", text)):
            paths.append(svg / f"{name}.{suffix}")
            write(paths[-1], content, svg, "svg")
    return paths
