"""The pictures of a measured record as SVG: those of a certificate, from its plain contents, and one of a fit alone.

They are specifications of Vega-Lite, written without Altair, whose import would take longer than the drawing.
"""

from __future__ import annotations

import math
import re
from base64 import b64encode
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bench.records.response import Response, thinned
from bench.reporting.pictures.theme import FULL, HALF, SERIES, theme
from bench.reporting.rounding import readable

BLUE, ORANGE, _, PURPLE = SERIES[:4]
INK, QUIET = (theme()["style"][name]["color"] for name in ("truth", "quiet"))
AGREEMENT = {"primary": INK, "agrees": BLUE, "tied": QUIET, "off": ORANGE, "-": QUIET}
ROOM = 34.0
"""Width of an axis with its labels, so that panels stand one above the other."""
MOST_MARKED = 250
"""Samples beyond this number are a line, not circles."""
WIDTHS = 3.0
"""Widths of the primary's interval to either side of its value beyond which another's is cut at the edge."""
Specification = dict[str, Any]
Curve = tuple[np.ndarray, np.ndarray]
"""Abscissae and ordinates."""
Drawn = tuple[Specification, str]
"""A picture and its caption."""


def svg(picture: Specification, ground: str | None = None) -> str:
    """Draw a picture in light colours, which a style sheet in it replaces where the reader prefers dark ones."""
    import vl_convert

    light, dark = (re.findall(r"#[0-9a-fA-F]{6}", str(theme(dark))) for dark in (False, True))
    rules = " ".join(
        f'[{attribute}="{old}"] {{ {attribute}: {new} }}'
        for old, new in dict(zip(light, dark, strict=True)).items()
        for attribute in ("fill", "stroke")
    )
    drawn = vl_convert.vegalite_to_svg({**picture, "padding": 3, "config": theme() | {"background": ground}})
    font = "text { font-family: 'DejaVu Sans', sans-serif }"
    style = f"<style>{font} @media (prefers-color-scheme: dark) {{ {rules} }}</style>"
    return str(drawn).replace(">", f">{style}", 1)


def fit_picture(response: Response) -> str:
    """Draw samples, fitted response and residuals as the content of an SVG file."""
    fit, labels = response.fit, (f"{response.measures} ({response.unit})", f"residual ({response.unit})")
    curves = {} if fit is None else {"fit": (BLUE, (fit.times, fit.values))}
    left = None if fit is None else fit.residuals.values
    title = response.method if fit is None else f"{response.method}: {response.trust.value}"
    picture = _over_time((response.times, response.values), curves, left, labels, FULL)
    return svg({**picture, "title": {"text": title, "orient": "top", "anchor": "end"}}, theme()["background"])


def pictures(shown: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Draw what can be drawn of a certificate's contents: addresses of images, with their captions."""
    drawn = [draw(shown) for draw in (_record, _prediction, _spectrum, _lags, _forest)]
    return [(_address(svg(picture[0])), picture[1]) for picture in drawn if picture]


def _address(drawing: str) -> str:
    return f"data:image/svg+xml;base64,{b64encode(drawing.encode()).decode()}"


def _curve(curve: Curve, mark: Mapping[str, Any], name: str = "") -> Specification:
    """Describe a curve; ``name`` is its entry in the legend."""
    values = [{"x": x, "y": y} for x, y in zip(*(part.tolist() for part in thinned(*curve)), strict=True)]
    color = {"color": {"datum": name}} if name else {}
    return {"data": {"values": values}, "mark": dict(mark), "encoding": {"x": _axis("x"), "y": _axis("y")} | color}


def _axis(field: str) -> dict[str, Any]:
    return {"field": field, "type": "quantitative"}


def _fixed(mark: Mapping[str, Any], **ends: float) -> Specification:
    """Describe a mark at given places: a grey region between the ends of x or of y, or a line."""
    places = {channel: {"datum": end} for channel, end in ends.items()}
    return {"data": {"values": [{}]}, "mark": dict(mark), "encoding": places}


REGION = {"type": "rect", "style": "region", "strokeWidth": 0}
RULE = {"type": "rule", "style": "quiet"}


def _panel(
    layers: Sequence[Specification], titles: tuple[str, str], size: tuple[float, float],
    colours: Mapping[str, str] | None = None, log: Sequence[float] = (),
) -> Specification:  # fmt: skip
    """Lay curves over each other, under a legend of their colours; ``log``: the ends of y, on logarithmic axes."""
    scale = {"type": "log", "nice": False} if log else {"zero": False, "nice": False}
    axis = {"format": ".6~g", "tickCount": 5}
    across = {"scale": scale, "title": titles[0] or None, "axis": axis | {"grid": False}}
    up = {"scale": scale | ({"domain": list(log)} if log else {}), "title": titles[1],
          "axis": axis | {"minExtent": ROOM, "maxExtent": ROOM}}  # fmt: skip
    encoding: dict[str, Any] = {"x": across, "y": up}
    if colours:
        legend = {"orient": "top", "symbolType": "stroke", "symbolStrokeWidth": 2}
        named = {"domain": list(colours), "range": list(colours.values())}
        encoding["color"] = {"type": "nominal", "scale": named, "legend": legend}
    return {"width": size[0] - ROOM, "height": size[1], "encoding": encoding, "layer": list(layers)}


def _over_time(
    samples: Curve, curves: Mapping[str, tuple[str, Curve]], left: np.ndarray | None, labels: tuple[str, str],
    width: float = HALF, under: Sequence[Specification] = (),
) -> Specification:  # fmt: skip
    """Draw samples and curves in their colours and, below, what is left of the samples."""
    few = samples[0].size <= MOST_MARKED
    broad = {"type": "line", "strokeWidth": 1.8 if curves else 0.6, "strokeJoin": "round"}
    colours = {"record": INK if few or not curves else QUIET} | {name: colour for name, (colour, _) in curves.items()}
    layers = [*under, _curve(samples, {"type": "circle", "size": 7, "opacity": 1} if few else broad, "record")]
    layers += [_curve(curve, {"type": "line", "strokeWidth": 0.7}, name) for name, (_, curve) in curves.items()]
    above = _panel(layers, ("time (s)" if left is None else "", labels[0]), (width, 0.36 * width), colours)
    if left is None:
        return above
    rest = _curve((samples[0], left), {"type": "line", "strokeWidth": 0.5, "color": ORANGE})
    below = _panel([*under, _fixed(RULE, y=0.0), rest], ("time (s)", labels[1]), (width, 0.15 * width))
    return {"vconcat": [above, below], "spacing": 4}


# Each returns a picture with its caption; None where there is nothing to draw.


def _record(shown: Mapping[str, Any]) -> Drawn:
    series, unit = shown["series"], shown["series"]["unit"]
    curves = {} if series["fit"] is None else {"fit": (BLUE, (series["times"], series["fit"]))}
    labels = f"{series['measures']} ({unit})", f"residual ({unit})"
    picture = _over_time((series["times"], series["values"]), curves, series["residuals"], labels)
    return picture, "Measured samples" + (", fitted motion, and residuals." if curves else "; there is no fit to draw.")


def _prediction(shown: Mapping[str, Any]) -> Drawn | None:
    series, prediction = shown["series"], shown["prediction"]
    if prediction is None:
        return None
    times, values, predicted, split = series["times"], series["values"], series["prediction"], prediction["split"]
    late = times > split
    curves = {
        "fit of the first 60 %": (BLUE, (times[~late], predicted[~late])),
        "prediction": (PURPLE, (times[late], predicted[late])),
    }
    labels = f"{series['measures']} ({series['unit']})", f"error ({series['unit']})"
    region = _fixed(REGION, x=split, x2=float(times[-1]))
    return _over_time((times, values), curves, values - predicted, labels, under=[region]), (
        f"Held out: FIT {prediction['fit_pct']:.1f} %. The last 40 % of the record (grey) was not used by the fit that "
        "predicts it. FIT is 100 % for a perfect prediction, 0 % for one no better than the mean."
    )


def _spectrum(shown: Mapping[str, Any]) -> Drawn | None:
    spectrum, unit = shown["series"]["spectrum"], shown["series"]["unit"]
    if spectrum is None:
        return None
    (low, high), power, frequencies = spectrum["white_band"], spectrum["periodogram"], spectrum["frequencies"]
    most = 2.0 * max(float(np.max(power)), high, 1e-300)
    least = max(0.5 * min(float(np.percentile(power, 0.5)), low), 1e-12 * most)
    smooth = f"AR({spectrum['order']})"
    layers = [
        _fixed(REGION, y=max(low, least), y2=max(high, least)),
        _curve((frequencies, np.clip(power, least, most)), {"type": "line", "strokeWidth": 0.5}, "periodogram"),
        _curve((frequencies, np.clip(spectrum["autoregression"], least, most)), {"type": "line"}, smooth),
    ]
    if spectrum["natural_frequency"] is not None:
        layers.append(_fixed(RULE | {"strokeDash": [2, 2]}, x=spectrum["natural_frequency"]))
    squared = f"({unit})²" if "/" in unit else f"{unit}²"
    titles = "frequency (Hz)", f"density ({squared}/Hz)"
    return _panel(layers, titles, (HALF, 0.45 * HALF), {"periodogram": BLUE, smooth: ORANGE}, (least, most)), (
        "Spectrum of the residuals. White noise stays within the grey band at 95 of 100 frequencies; smooth line: "
        "the autoregression that the intervals assume for the noise. Dotted: the natural frequency."
    )


def _lags(shown: Mapping[str, Any]) -> Drawn | None:
    correlation = shown["series"]["autocorrelation"]
    if correlation is None:
        return None
    values, band = correlation["values"][1:], correlation["band"]
    bars = _curve((np.arange(1, values.size + 1), values), {"type": "bar", "width": 1.2, "color": BLUE})
    layers = [_fixed(REGION, y=-band, y2=band), _fixed(RULE, y=0.0), bars]
    picture = _panel(layers, ("lag (samples)", "autocorrelation"), (HALF, 0.45 * HALF))
    return picture, "Autocorrelation of the residuals. Of white noise, 95 of 100 bars stay within the grey band."


def _forest(shown: Mapping[str, Any]) -> Drawn | None:
    methods = [method for method in shown["methods"] if any(name in method["values"] for name in shown["compared"])]
    names = [name for name in shown["compared"] if any(name in method["values"] for method in methods)]
    if not names:
        return None
    width = (HALF - 2 * ROOM) / len(names)
    panels = [_intervals(name, methods, shown["values"].get(name), width, name == names[0]) for name in names]
    return {"hconcat": panels, "spacing": 12}, (
        "95 % intervals: thin of a repeat, thick of this record; grey: the primary method's. Blue agrees with it, grey "
        "bars are tied with it, orange is off: neither interval covers the other's value. Triangles: beyond the plot."
    )


def _intervals(
    name: str, methods: Sequence[Mapping[str, Any]], reference: Mapping[str, Any] | None, width: float, first: bool
) -> Specification:
    """Draw the intervals of a quantity, one above the other, as far as the primary's lets them be seen."""
    stated = [method for method in methods if name in method["values"]]
    ends = [method["values"][name][end] for method in stated for end in ("low", "high")]
    ends = [end for end in ends if math.isfinite(end)] or [0.0, 1.0]
    low, high = min(ends), max(ends)
    region = []
    if reference is not None and math.isfinite(extent := reference["high"] - reference["low"]):
        low, high = max(low, reference["value"] - WIDTHS * extent), min(high, reference["value"] + WIDTHS * extent)
        region = [_fixed(REGION, x=max(reference["low"], low), x2=min(reference["high"], high))]
    margin = 0.06 * (high - low) or 0.1 * abs(high) or 1.0
    low, high = low - margin, high + margin
    rows = []
    for method in stated:
        interval = method["values"][name]
        row = {end: min(max(interval[end], low), high) for end in ("value", "low", "high", "record_low", "record_high")}
        beyond = "triangle-left" if interval["value"] < low else "triangle-right" if interval["value"] > high else ""
        colour = AGREEMENT[method["agreement"].get(name, "-")]
        rows.append(row | {"method": method["method"], "shape": beyond or "circle", "colour": colour})

    def layer(mark: Mapping[str, Any], x: str, **channels: Any) -> Specification:
        return {"data": {"values": rows}, "mark": dict(mark), "encoding": {
            "y": {"field": "method", "type": "nominal"}, "x": _axis(x), "color": {"field": "colour", "scale": None},
            **{channel: {"field": field} for channel, field in channels.items()},
        }}  # fmt: skip

    points = layer({"type": "point", "size": 14, "filled": True, "opacity": 1}, "value", shape="shape")
    points["encoding"]["shape"]["scale"] = None
    thin, thick = ({"type": "rule", "strokeWidth": wide} for wide in (0.9, 2.4))
    axis = {"format": ".6~g", "tickCount": 3, "labelOverlap": True}
    order, names = [method["method"] for method in methods], {"domain": False, "ticks": False}
    unit = stated[0]["values"][name]["unit"]
    return {
        "width": width,
        "height": 11 * len(methods),
        "title": {"text": readable(name) + ("" if unit == "-" else f" ({unit})"), "orient": "top", "anchor": "start"},
        "encoding": {
            "x": {"scale": {"domain": [low, high], "nice": False, "zero": False}, "title": None, "axis": axis},
            "y": {"scale": {"domain": order}, "title": None, "axis": names if first else None},
        },
        "layer": [*region, layer(thin, "low", x2="high"), layer(thick, "record_low", x2="record_high"), points],
    }  # fmt: skip
