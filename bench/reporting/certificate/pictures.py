"""Pictures of a measured record as SVG: those of a certificate, from its contents, and one of a single fit.

The specifications of Vega-Lite are written without Altair, whose import would take longer than the drawing.
"""

from __future__ import annotations

import math
import re
from base64 import b64encode
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bench.contract.modal import FreeDecays
from bench.records.modal import ModalFinding, modal_response
from bench.records.response import Response, thinned
from bench.reporting.pictures.theme import FULL, HALF, INK, QUIET, SERIES, THEME
from bench.reporting.rounding import readable

BLUE, ORANGE, _, PURPLE = SERIES[:4]
AGREEMENT = {"primary": INK, "agrees": BLUE, "tied": QUIET, "off": ORANGE, "-": QUIET}
ROOM = 34.0
"""Width of an axis with its labels, equal for aligned panels."""
MOST_MARKED = 250
"""Largest number of samples drawn as circles; more are drawn as a line."""
WIDTHS = 3.0
"""Limits of the plot of intervals: widths of the primary's interval to either side of its value."""
ENDS = ("value", "low", "high", "record_low", "record_high")
REGION = {"type": "rect", "style": "region", "strokeWidth": 0}
RULE = {"type": "rule", "style": "quiet"}
Specification = dict[str, Any]
Curve = tuple[np.ndarray, np.ndarray]
"""Abscissae and ordinates."""
Drawn = tuple[Specification, str]
"""A picture and its caption."""


def svg(picture: Specification) -> str:
    """Draw a picture with lengths in points, in the font of the reader if DejaVu Sans is missing."""
    import vl_convert

    drawn = vl_convert.vegalite_to_svg({**picture, "padding": 3, "config": THEME})
    style = "<style>text { font-family: 'DejaVu Sans', sans-serif }</style>"
    in_points = re.sub(r'(width|height)="([\d.]+)"', r'\1="\2pt"', drawn, count=2)
    return in_points.replace(">", f">{style}", 1)


def fit_picture(response: Response) -> str:
    """Draw samples, fitted response and residuals as the content of an SVG file."""
    return svg(_fit_over_time(response))


def _fit_over_time(response: Response) -> Specification:
    fit, labels = response.fit, (f"{response.measures} ({response.unit})", f"residual ({response.unit})")
    curves = {} if fit is None else {"fit": (BLUE, (fit.times, fit.values))}
    left = {} if fit is None else {ORANGE: (response.times, fit.residuals.values)}
    title = response.method if fit is None else f"{response.method}: {response.trust.value}"
    picture = _over_time((response.times, response.values), curves, left, labels, FULL)
    return {**picture, "title": {"text": title, "orient": "top", "anchor": "end"}}


def modes_picture(finding: ModalFinding) -> str:
    """Draw the first channel with its fit, and the spectra, as the content of a file."""
    response, spectra = modal_response(finding), spectra_of_modes(finding)
    panels = [] if response is None else [_fit_over_time(response)]
    panels += [_modes_over_frequency(spectra, FULL)] if spectra else []
    return svg({"vconcat": panels, "resolve": {"scale": {"color": "independent"}}})


def spectra_of_modes(finding: ModalFinding) -> dict[str, Any] | None:
    """Return amplitudes of record, modes and residuals by frequency, for the channel that moves most, or None."""
    comparison = finding.comparison
    if comparison is None:
        return None
    i = int(np.argmax(np.linalg.norm(comparison.measured, axis=1)))
    measured, fitted, free = comparison.measured[i], comparison.fitted[i], isinstance(finding.record.data, FreeDecays)
    return {
        "frequencies": comparison.frequencies, "unit": finding.record.units[i] + ("" if free else " per N"),
        "record": np.abs(measured), "modes": np.abs(fitted), "residuals": np.abs(measured - fitted),
        "natural_frequencies": [mode.frequency for mode in finding.estimate.modes],
    }  # fmt: skip


def _modes_over_frequency(spectra: Mapping[str, Any], width: float) -> Specification:
    colours = {"record": INK, "modes": BLUE, "residuals": ORANGE}
    most = 2.0 * max(float(np.max(spectra[name])) for name in colours)
    least = max(0.5 * float(np.percentile(spectra["residuals"], 2)), 1e-9 * most)
    layers = [_fixed(RULE | {"strokeDash": [2, 2]}, x=frequency) for frequency in spectra["natural_frequencies"]]
    layers += [
        _curve((spectra["frequencies"], np.clip(spectra[name], least, most)), name, strokeWidth=0.7) for name in colours
    ]
    titles = "frequency (Hz)", f"amplitude ({spectra['unit']})"
    return _panel(layers, titles, 0.36 * width, width, colours, log=(least, most))


def pictures(shown: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Draw the pictures of a certificate; returns addresses of images with their captions."""
    drawn = (draw(shown) for draw in (_record, _modes, _spectrum, _forest))
    code = "data:image/svg+xml;base64,"
    return [(code + b64encode(svg(picture[0]).encode()).decode(), picture[1]) for picture in drawn if picture]


def _curve(curve: Curve, name: str = "", **mark: Any) -> Specification:
    """Describe a curve; ``name`` is its entry in the legend."""
    values = [{"x": x, "y": y} for x, y in zip(*(part.tolist() for part in thinned(*curve)), strict=True)]
    places: dict[str, Any] = {axis: {"field": axis, "type": "quantitative"} for axis in "xy"}
    return {"data": {"values": values}, "mark": {"type": "line"} | mark,
            "encoding": places | ({"color": {"datum": name}} if name else {})}  # fmt: skip


def _fixed(mark: Mapping[str, Any], **ends: float) -> Specification:
    """Describe a mark at given places: a grey region between the ends of x or of y, or a line."""
    places = {channel: {"datum": end} for channel, end in ends.items()}
    return {"data": {"values": [{}]}, "mark": dict(mark), "encoding": places}


def _panel(
    layers: Sequence[Specification], titles: tuple[str, str], height: float, width: float = HALF,
    colours: Mapping[str, str] | None = None, log: Sequence[float] = (),
) -> Specification:  # fmt: skip
    """Draw layers in one panel with a legend of colours; ``log``: limits of y, for logarithmic axes."""
    scale = {"type": "log", "nice": False} if log else {"zero": False, "nice": False}
    axis = {"format": ".6~g", "tickCount": 5}
    encoding: dict[str, Any] = {
        "x": {"scale": scale, "title": titles[0] or None, "axis": axis | {"grid": False}},
        "y": {"scale": scale | ({"domain": list(log)} if log else {}), "title": titles[1],
              "axis": axis | {"minExtent": ROOM, "maxExtent": ROOM}},
    }  # fmt: skip
    if colours:
        legend = {"orient": "top", "symbolType": "stroke", "symbolStrokeWidth": 2}
        named = {"domain": list(colours), "range": list(colours.values())}
        encoding["color"] = {"type": "nominal", "scale": named, "legend": legend}
    return {"width": width - ROOM, "height": height, "encoding": encoding, "layer": list(layers)}


def _over_time(
    samples: Curve, curves: Mapping[str, tuple[str, Curve]], left: Mapping[str, Curve], labels: tuple[str, str],
    width: float = HALF, under: Sequence[Specification] = (),
) -> Specification:  # fmt: skip
    """Draw samples and curves by colour and, in a panel below, residuals by colour."""
    few = samples[0].size <= MOST_MARKED
    colours = {"record": INK if few or not curves else QUIET} | {name: colour for name, (colour, _) in curves.items()}
    mark = {"type": "circle", "size": 7, "opacity": 1} if few else {"strokeWidth": 1.8 if curves else 0.6}
    layers = [*under, _curve(samples, "record", strokeJoin="round", **mark)]
    layers += [_curve(curve, name, strokeWidth=0.7) for name, (_, curve) in curves.items()]
    above = _panel(layers, ("" if left else "time (s)", labels[0]), 0.36 * width, width, colours)
    if not left:
        return above
    layers = [*under, _fixed(RULE, y=0.0)]
    layers += [_curve(curve, strokeWidth=0.5, color=colour) for colour, curve in left.items()]
    return {"vconcat": [above, _panel(layers, ("time (s)", labels[1]), 0.15 * width, width)], "spacing": 4}


# Each of these functions returns a picture with its caption, or None without data.


def _record(shown: Mapping[str, Any]) -> Drawn | None:
    series, prediction = shown["series"], shown["prediction"]
    if "times" not in series:
        return None
    unit = series["unit"]
    times, values, labels = series["times"], series["values"], (f"{series['measures']} ({unit})", f"residual ({unit})")
    if series["fit"] is None:
        return _over_time((times, values), {}, {}, labels), "Measured samples; there is no fit to draw."
    curves, left = {"fit": (BLUE, (times, series["fit"]))}, {ORANGE: (times, series["residuals"])}
    caption = "Measured samples, fitted motion, and residuals."
    if prediction is None:
        return _over_time((times, values), curves, left, labels), caption
    late = times > prediction["split"]
    curves["prediction"] = PURPLE, (times[late], series["prediction"][late])
    left[PURPLE] = times[late], (values - series["prediction"])[late]
    region = _fixed(REGION, x=prediction["split"], x2=float(times[-1]))
    return _over_time((times, values), curves, left, labels, under=[region]), (
        f"{caption} Grey: the last 40 %, predicted by a fit of the first 60 %: FIT {prediction['fit_pct']:.1f} % "
        "(100 %: perfect prediction; 0 %: no better than the mean)."
    )


def _modes(shown: Mapping[str, Any]) -> Drawn | None:
    spectra = shown["series"].get("modes")
    return spectra and (
        _modes_over_frequency(spectra, HALF),
        "Spectra of the record, of the modes, and of the residuals. Dotted: the natural frequencies.",
    )


def _spectrum(shown: Mapping[str, Any]) -> Drawn | None:
    spectrum = shown["series"]["spectrum"]
    if spectrum is None:
        return None
    unit = shown["series"]["unit"]
    (low, high), power, frequencies = spectrum["white_band"], spectrum["periodogram"], spectrum["frequencies"]
    most = 2.0 * max(float(np.max(power)), high, 1e-300)
    least = max(0.5 * min(float(np.percentile(power, 0.5)), low), 1e-12 * most)
    smooth = f"AR({spectrum['order']})"
    layers = [
        _fixed(REGION, y=max(low, least), y2=max(high, least)),
        _curve((frequencies, np.clip(power, least, most)), "periodogram", strokeWidth=0.5),
        _curve((frequencies, np.clip(spectrum["autoregression"], least, most)), smooth),
    ]
    if spectrum["natural_frequency"] is not None:
        layers.append(_fixed(RULE | {"strokeDash": [2, 2]}, x=spectrum["natural_frequency"]))
    titles = "frequency (Hz)", f"density ({f'({unit})' if '/' in unit else unit}²/Hz)"
    colours = {"periodogram": BLUE, smooth: ORANGE}
    return _panel(layers, titles, 0.45 * HALF, colours=colours, log=(least, most)), (
        "Spectrum of the residuals. Grey: 95 % band of white noise. Smooth line: the autoregressive noise model of the "
        "intervals. Dotted: the natural frequency."
    )


def _forest(shown: Mapping[str, Any]) -> Drawn | None:
    rows = []
    for name in shown["compared"]:
        reference = shown["methods"][0]["values"].get(name)
        if reference is None or not math.isfinite(reference["high"]):
            continue
        room = WIDTHS * (reference["high"] - reference["low"])
        for method in (method for method in shown["methods"] if name in method["values"]):
            interval = method["values"][name]
            ends = np.clip([interval[end] for end in ENDS], reference["value"] - room, reference["value"] + room)
            quantity = readable(name) + (f" ({interval['unit']})" if interval["unit"] != "-" else "")
            colour = AGREEMENT[method["agreement"][name]]
            row = {"quantity": quantity, "method": method["method"], "colour": colour}
            rows.append(row | dict(zip(ENDS, ends.tolist(), strict=True)))
    if not rows:
        return None
    quantities, methods = (list(dict.fromkeys(row[key] for row in rows)) for key in ("quantity", "method"))
    across = {"type": "quantitative", "title": None, "scale": {"zero": False, "nice": False, "padding": 4},
              "axis": {"format": ".6~g", "tickCount": 3, "labelOverlap": True}}  # fmt: skip
    up = {"field": "method", "type": "nominal", "sort": methods, "title": None,
          "axis": {"domain": False, "ticks": False}}  # fmt: skip
    of_method = {"y": up, "color": {"field": "colour", "scale": None}}
    wide, narrow = (
        {"x": {"field": f"{of}low", **across}, "x2": {"field": f"{of}high"}, **of_method} for of in ("", "record_")
    )
    layers = [
        {"mark": REGION, "encoding": {name: wide[name] for name in ("x", "x2")},
         "transform": [{"filter": {"field": "colour", "equal": INK}}]},
        {"mark": {"type": "rule", "strokeWidth": 0.9}, "encoding": wide},
        {"mark": {"type": "rule", "strokeWidth": 2.4}, "encoding": narrow},
        {"mark": {"type": "point", "size": 14, "filled": True, "opacity": 1},
         "encoding": {"x": {"field": "value", **across}, **of_method}},
    ]  # fmt: skip
    heading = {"field": "quantity", "sort": quantities, "title": None, "header": {"labelAnchor": "start"}}
    return {
        "data": {"values": rows},
        "facet": {"column": heading},
        "spec": {"width": (HALF - 2 * ROOM) / len(quantities), "height": 11 * len(methods), "layer": layers},
        "resolve": {"scale": {"x": "independent"}},
    }, (
        f"95 % intervals{': thin of a repeat, thick of this record' if shown['values'] else ' of this record'}. Grey "
        "region: the primary method. Blue bars agree with it, grey bars are tied with it; for orange bars neither "
        "interval covers the other value. Values at an edge lie outside of the plot."
    )
