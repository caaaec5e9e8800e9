"""The pictures of a certificate, from its plain contents, as inline SVGs in the colours of the page."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.reporting.inline_svg import INK, LINE, MUTED, RC, SERIES, pyplot, row_axis, svg
from bench.reporting.rounding import readable

SIZE = (5.6, 3.5)
MOST_POINTS = 1200
MOST_MARKED = 250
"""Samples beyond this number are a line, not circles."""
BLUE, ORANGE, GREEN, PURPLE = SERIES
AGREEMENT = {"primary": INK, "agrees": BLUE, "tied": MUTED, "off": ORANGE, "-": MUTED}
MOST_WIDER = 8.0
"""An interval beyond so many times the primary's reach is cut at the edge of the plot."""


@dataclass(frozen=True)
class CertificatePicture:
    """An SVG with its caption."""

    drawing: str
    caption: str


def pictures(shown: Mapping[str, Any]) -> list[CertificatePicture]:
    """What can be drawn of a certificate's contents."""
    series = shown["series"]
    drawers: list[tuple[str, str, bool, Callable[[Any, Any, Mapping[str, Any]], None], float]] = [
        ("record", "Record, fit and residual", True, _record, 1.25),
        ("prediction", "Prediction of what was held out", shown["prediction"] is not None, _prediction, 1.25),
        ("spectrum", "Spectrum of the residuals", series["spectrum"] is not None, _spectrum, 1.0),
        ("lags", "Autocorrelation of the residuals", series["autocorrelation"] is not None, _lags, 1.0),
        ("forest", "Methods side by side", bool(_rows(shown)), _forest, _height(shown)),
    ]
    found, plt = [], pyplot()
    for name, title, there, draw, height in drawers:
        if there:
            with plt.rc_context(RC):
                figure = plt.figure(figsize=(SIZE[0], SIZE[1] * height), layout="constrained")
                draw(figure, series, shown)
                found.append(CertificatePicture(svg(figure, title, name), CAPTIONS[name](shown)))
    return found


def thinned(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """At most :data:`MOST_POINTS` points of a curve: the smallest and largest of every stretch, in their order."""
    if x.size <= MOST_POINTS:
        return x, y
    kept = set()
    for part in np.array_split(np.arange(x.size), MOST_POINTS // 2):
        kept |= {int(part[np.argmin(y[part])]), int(part[np.argmax(y[part])])}
    order = np.array(sorted(kept))
    return x[order], y[order]


def _label(series: Mapping[str, Any]) -> str:
    return f"{series['measures']} ({series['unit']})"


def _samples(axis: Any, times: np.ndarray, values: np.ndarray, label: str = "record") -> None:
    if times.size <= MOST_MARKED:
        axis.plot(times, values, "o", color=INK, ms=2.6, mew=0, label=label)
    else:
        axis.plot(*thinned(times, values), color=LINE, lw=3.2, solid_capstyle="round", label=label)


def _above(axis: Any, room: float = 0.28) -> None:
    """Room for a legend above the curves."""
    low, high = axis.get_ylim()
    axis.set_ylim(low, high + room * (high - low))
    axis.legend(loc="upper right", ncols=3, fontsize=9, borderaxespad=0.1, columnspacing=1.2, handlelength=1.6)
    axis.grid(lw=0.5)


def _record(figure: Any, series: Mapping[str, Any], shown: Mapping[str, Any]) -> None:
    times, fit = series["times"], series["fit"]
    drawn = None if fit is None else ((times, fit), series["residuals"])
    draw_record(figure, (times, series["values"]), drawn, _label(series), series["unit"])


Curve = tuple[np.ndarray, np.ndarray]
"""Times (s) and values."""


def draw_record(figure: Any, samples: Curve, fit: tuple[Curve, np.ndarray] | None, label: str, unit: str) -> None:
    """Draw samples with their fit and, below, the residual of each sample; or the samples alone where there is none."""
    if fit is None:
        axis = figure.subplots()
        axis.plot(*thinned(*samples), color=INK, lw=0.8, label="record")
        axis.set(xlabel="time (s)", ylabel=label, title="Record")
        _above(axis)
        return
    curve, residuals = fit
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    _samples(above, *samples)
    above.plot(*thinned(*curve), color=BLUE, lw=1.1, label="fit")
    above.set(ylabel=label, title="Record and fit")
    _above(above)
    _difference(figure, below, (samples[0], residuals), f"residual ({unit})")


def _difference(figure: Any, axis: Any, curve: Curve, label: str) -> None:
    """Draw what is left of the samples below them."""
    axis.axhline(0, color=MUTED, lw=0.7)
    axis.plot(*thinned(*curve), color=ORANGE, lw=0.8)
    axis.set(xlabel="time (s)", ylabel=label)
    axis.grid(lw=0.5)
    figure.align_ylabels()


def _prediction(figure: Any, series: Mapping[str, Any], shown: Mapping[str, Any]) -> None:
    times, values = series["times"], series["values"]
    split, predicted = shown["prediction"]["split"], series["prediction"]
    late = times > split
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    above.axvspan(split, times[-1], color=LINE, alpha=0.3, lw=0)
    below.axvspan(split, times[-1], color=LINE, alpha=0.3, lw=0)
    _samples(above, times, values)
    above.plot(*thinned(times[~late], predicted[~late]), color=BLUE, lw=1.1, label="fit of the first 60 %")
    above.plot(*thinned(times[late], predicted[late]), color=PURPLE, lw=1.1, label="prediction")
    above.set(ylabel=_label(series), title=f"Held out: FIT {shown['prediction']['fit_pct']:.1f} %")
    _above(above)
    _difference(figure, below, (times, values - predicted), f"error ({series['unit']})")


def _spectrum(figure: Any, series: Mapping[str, Any], shown: Mapping[str, Any]) -> None:
    axis, own = figure.subplots(), series["spectrum"]
    low, high = own["white_band"]
    axis.axhspan(low, high, color=LINE, alpha=0.5, lw=0, label="white noise, 95 %")
    power = np.maximum(own["periodogram"], 1e-12 * float(np.max(own["periodogram"])) or 1e-300)
    axis.plot(*thinned(own["frequencies"], power), color=BLUE, lw=0.7, label="periodogram")
    axis.plot(*thinned(own["frequencies"], own["autoregression"]), color=ORANGE, lw=1.6, label=f"AR({own['order']})")
    if own["natural_frequency"] is not None:
        axis.axvline(own["natural_frequency"], color=MUTED, lw=0.9, ls=":")
    axis.set(yscale="log", xscale="log", xlabel="frequency (Hz)", ylabel=f"density ({_squared(series['unit'])}/Hz)")
    axis.set_title("Spectrum of the residuals", pad=22)
    bottom = float(np.percentile(power, 0.5))
    axis.set_ylim(0.5 * min(bottom, low), 2.0 * max(float(np.max(power)), high))
    _ticks_of_logs(axis.xaxis, lambda value: f"{value:g}")
    _ticks_of_logs(axis.yaxis, power_of_ten)
    axis.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=3, fontsize=9, borderaxespad=0.1, columnspacing=1.2)
    axis.grid(lw=0.5)


def _squared(unit: str) -> str:
    return f"{unit}²" if "/" not in unit else f"({unit})²"


def _ticks_of_logs(axis: Any, text: Callable[[float], str]) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(10.0, numticks=6))
    axis.set_major_formatter(FuncFormatter(lambda value, _: text(value)))
    axis.set_minor_formatter(NullFormatter())


def power_of_ten(value: float) -> str:
    """``10⁻⁵``, in letters that need no typesetting."""
    exponent = str(round(math.log10(value))) if value > 0 else "0"
    return "10" + exponent.translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def _lags(figure: Any, series: Mapping[str, Any], shown: Mapping[str, Any]) -> None:
    axis, own = figure.subplots(), series["autocorrelation"]
    values, band = np.asarray(own["values"])[1:], own["band"]
    axis.axhspan(-band, band, color=LINE, alpha=0.5, lw=0, label="white noise, 95 %")
    axis.axhline(0, color=MUTED, lw=0.7)
    axis.vlines(np.arange(1, values.size + 1), 0, values, color=BLUE, lw=1.6)
    axis.set(xlabel="lag (samples)", ylabel="autocorrelation", title="Autocorrelation of the residuals")
    reach = 1.1 * max(2 * band, float(np.max(values, initial=0.0)))
    axis.set_ylim(1.1 * min(-2 * band, float(np.min(values, initial=0.0))), reach)
    _above(axis, 0.12)


def _rows(shown: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    return [one for one in shown["methods"] if any(name in one["values"] for name in shown["compared"])]


def _height(shown: Mapping[str, Any]) -> float:
    return (1.3 + 0.24 * len(_rows(shown))) / SIZE[1]


def _forest(figure: Any, series: Mapping[str, Any], shown: Mapping[str, Any]) -> None:
    rows = _rows(shown)[::-1]
    names = [name for name in shown["compared"] if any(name in one["values"] for one in rows)]
    axes = figure.subplots(1, len(names), sharey=True, squeeze=False)[0]
    for axis, name in zip(axes, names, strict=True):
        _forest_of(axis, name, rows, shown)
    axes[0].set_yticks(range(len(rows)), [one["method"] for one in rows], fontsize=9)
    axes[0].set_ylim(-0.7, len(rows) - 0.3)


def _forest_of(axis: Any, name: str, rows: Sequence[Mapping[str, Any]], shown: Mapping[str, Any]) -> None:
    from matplotlib.ticker import MaxNLocator

    intervals = {i: one["values"][name] for i, one in enumerate(rows) if name in one["values"]}
    reference = shown["values"].get(name)
    low, high = _limits(reference, list(intervals.values()))
    if reference is not None:
        axis.axvspan(*np.clip([reference["low"], reference["high"]], low, high), color=LINE, alpha=0.5, lw=0)
    for i, interval in intervals.items():
        colour = AGREEMENT[rows[i]["agreement"].get(name, "-")]
        for ends, width in (("", 1.8), ("record_", 4.0)):
            drawn = np.clip([interval[f"{ends}low"], interval[f"{ends}high"]], low, high)
            axis.plot(drawn, [i, i], color=colour, lw=width, solid_capstyle="butt")
        inside = low <= interval["value"] <= high
        marker = "o" if inside else "<" if interval["value"] < low else ">"
        axis.plot(np.clip(interval["value"], low, high), i, marker, color=colour, ms=4.5, clip_on=False)
    unit = next(iter(intervals.values()))["unit"]
    axis.set_title(readable(name) + ("" if unit == "-" else f" ({unit})"))
    axis.set_xlim(low, high)
    axis.xaxis.set_major_locator(MaxNLocator(4))
    axis.ticklabel_format(axis="x", useOffset=False, style="plain")
    row_axis(axis)


def _limits(reference: Mapping[str, Any] | None, intervals: Sequence[Mapping[str, Any]]) -> tuple[float, float]:
    """Return the ends of the plot: most intervals whole, and at most some widths of the primary's."""
    ends = [own[end] for own in intervals for end in ("low", "high") if math.isfinite(own[end])] or [0.0, 1.0]
    low, high = min(ends), max(ends)
    if reference is not None and math.isfinite(reference["high"] - reference["low"]):
        width, value = reference["high"] - reference["low"], reference["value"]
        distances = sorted(abs(end - value) for end in ends)
        reach = min(max(3.0 * width, distances[len(distances) // 2]), MOST_WIDER * width)
        low, high = max(low, value - reach), min(high, value + reach)
    margin = 0.06 * (high - low) or 0.1 * abs(high) or 1.0
    return low - margin, high + margin


CAPTIONS: dict[str, Callable[[Mapping[str, Any]], str]] = {
    "record": lambda shown: (
        "Measured samples, fitted motion, and their difference."
        if shown["series"]["fit"] is not None
        else "Measured samples; there is no fit to draw."
    ),
    "prediction": lambda shown: (
        "The last 40 % of the record (grey) was not used by the fit that predicts it. "
        "FIT is 100 % for a perfect prediction, 0 % for one no better than the mean."
    ),
    "spectrum": lambda shown: (
        "White noise stays within the band at 95 of 100 frequencies; the smooth line is the "
        "autoregression that the intervals assume for the noise. Dotted: the natural frequency."
    ),
    "lags": lambda shown: "Of white noise, 95 of 100 bars stay within the band.",
    "forest": lambda shown: (
        "95 % intervals: thin of a repeat, thick of this record; grey: the primary method's. Blue agrees with it, "
        "grey bars are tied with it, orange is off: neither interval covers the other's value. "
        "Arrow heads lie beyond the plot."
    ),
}
