"""The pictures of a certificate, from its plain contents."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bench.reporting.inline_svg import INK, LINE, MUTED, RC, SERIES, pyplot, svg_address
from bench.reporting.rounding import readable

SIZE = (5.6, 3.5)
MOST_POINTS = 1200
MOST_MARKED = 250
"""Samples beyond this number are a line, not circles."""
BLUE, ORANGE, _, PURPLE = SERIES
AGREEMENT = {"primary": INK, "agrees": BLUE, "tied": MUTED, "off": ORANGE, "-": MUTED}
WIDTHS = 3.0
"""Widths of the primary's interval to either side of its value beyond which another's is cut at the edge."""
Curve = tuple[np.ndarray, np.ndarray]
"""Times (s) and values."""


def pictures(shown: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Draw what can be drawn of a certificate's contents: addresses of images, with their captions."""
    plt, drawn = pyplot(), []
    with plt.rc_context(RC):
        for draw in (_record, _prediction, _spectrum, _lags, _forest):
            figure = plt.figure(figsize=SIZE, layout="constrained")
            caption = draw(figure, shown)
            if caption:
                drawn.append((svg_address(figure), caption))
            plt.close(figure)
    return drawn


def thinned(x: np.ndarray, y: np.ndarray) -> Curve:
    """Return at most :data:`MOST_POINTS` points of a curve: the smallest and largest of every stretch, in order."""
    if x.size <= MOST_POINTS:
        return x, y
    parts = np.array_split(np.arange(x.size), MOST_POINTS // 2)
    kept = np.unique([part[i] for part in parts for i in (np.argmin(y[part]), np.argmax(y[part]))])
    return x[kept], y[kept]


def draw_record(figure: Any, samples: Curve, fit: tuple[Curve, np.ndarray] | None, label: str, unit: str) -> None:
    """Draw samples with their fit and, below, the residual of each sample; or the samples alone where there is none."""
    if fit is None:
        axis = figure.subplots()
        axis.plot(*thinned(*samples), color=INK, lw=0.8, label="record")
        axis.set(xlabel="time (s)", ylabel=label, title="Record")
        _legend(axis)
        return
    curve, residuals = fit
    _with_difference(figure, samples, {"fit": (curve, BLUE)}, residuals, (label, f"residual ({unit})"))
    figure.axes[0].set_title("Record and fit")


def _with_difference(
    figure: Any, samples: Curve, curves: Mapping[str, tuple[Curve, str]], left: np.ndarray, labels: tuple[str, str]
) -> None:
    """Draw samples and curves in their colours and, below, what is left of the samples."""
    width, height = figure.get_size_inches()
    figure.set_size_inches(width, 1.25 * height)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    if samples[0].size <= MOST_MARKED:
        above.plot(*samples, "o", color=INK, ms=2.6, mew=0, label="record")
    else:
        above.plot(*thinned(*samples), color=LINE, lw=3.2, solid_capstyle="round", label="record")
    for name, (curve, colour) in curves.items():
        above.plot(*thinned(*curve), color=colour, lw=1.1, label=name)
    above.set_ylabel(labels[0])
    _legend(above)
    below.axhline(0, color=MUTED, lw=0.7)
    below.plot(*thinned(samples[0], left), color=ORANGE, lw=0.8)
    below.set(xlabel="time (s)", ylabel=labels[1])
    below.grid(lw=0.5)
    figure.align_ylabels()


def _legend(axis: Any) -> None:
    """Put the legend above the curves."""
    axis.margins(y=0.05)
    low, high = axis.get_ylim()
    axis.set_ylim(low, high + 0.2 * (high - low))
    axis.legend(loc="upper right", ncols=3, fontsize=9, borderaxespad=0.1, columnspacing=1.2, handlelength=1.6)
    axis.grid(lw=0.5)


# Each draws on an empty figure and returns its caption; an empty one where there is nothing to draw.


def _record(figure: Any, shown: Mapping[str, Any]) -> str:
    series = shown["series"]
    times, fit = series["times"], series["fit"]
    drawn = None if fit is None else ((times, fit), series["residuals"])
    label = f"{series['measures']} ({series['unit']})"
    draw_record(figure, (times, series["values"]), drawn, label, series["unit"])
    return "Measured samples" + ("; there is no fit to draw." if fit is None else ", fitted motion, and residuals.")


def _prediction(figure: Any, shown: Mapping[str, Any]) -> str:
    series, prediction = shown["series"], shown["prediction"]
    if prediction is None:
        return ""
    times, values, predicted = series["times"], series["values"], series["prediction"]
    late = times > prediction["split"]
    curves = {
        "fit of the first 60 %": ((times[~late], predicted[~late]), BLUE),
        "prediction": ((times[late], predicted[late]), PURPLE),
    }
    labels = f"{series['measures']} ({series['unit']})", f"error ({series['unit']})"
    _with_difference(figure, (times, values), curves, values - predicted, labels)
    for axis in figure.axes:
        axis.axvspan(prediction["split"], times[-1], color=LINE, alpha=0.3, lw=0, zorder=0)
    figure.axes[0].set_title(f"Held out: FIT {prediction['fit_pct']:.1f} %")
    return (
        "The last 40 % of the record (grey) was not used by the fit that predicts it. "
        "FIT is 100 % for a perfect prediction, 0 % for one no better than the mean."
    )


def _spectrum(figure: Any, shown: Mapping[str, Any]) -> str:
    spectrum, unit = shown["series"]["spectrum"], shown["series"]["unit"]
    if spectrum is None:
        return ""
    axis, (low, high), power = figure.subplots(), spectrum["white_band"], spectrum["periodogram"]
    power = np.maximum(power, 1e-12 * float(np.max(power)) or 1e-300)
    axis.axhspan(low, high, color=LINE, alpha=0.5, lw=0, label="white noise, 95 %")
    axis.plot(*thinned(spectrum["frequencies"], power), color=BLUE, lw=0.7, label="periodogram")
    smooth = thinned(spectrum["frequencies"], spectrum["autoregression"])
    axis.plot(*smooth, color=ORANGE, lw=1.6, label=f"AR({spectrum['order']})")
    if spectrum["natural_frequency"] is not None:
        axis.axvline(spectrum["natural_frequency"], color=MUTED, lw=0.9, ls=":")
    squared = f"({unit})²" if "/" in unit else f"{unit}²"
    axis.set(yscale="log", xscale="log", xlabel="frequency (Hz)", ylabel=f"density ({squared}/Hz)")
    axis.set_ylim(0.5 * min(float(np.percentile(power, 0.5)), low), 2.0 * max(float(np.max(power)), high))
    for ticks in (axis.xaxis, axis.yaxis):
        ticks.set_major_formatter("{x:g}")
        ticks.set_minor_formatter("")
    axis.set_title("Spectrum of the residuals", pad=22)
    axis.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=3, fontsize=9, borderaxespad=0.1, columnspacing=1.2)
    axis.grid(lw=0.5)
    return (
        "White noise stays within the band at 95 of 100 frequencies; the smooth line is the autoregression that the "
        "intervals assume for the noise. Dotted: the natural frequency."
    )


def _lags(figure: Any, shown: Mapping[str, Any]) -> str:
    correlation = shown["series"]["autocorrelation"]
    if correlation is None:
        return ""
    axis, values, band = figure.subplots(), correlation["values"][1:], correlation["band"]
    axis.axhspan(-band, band, color=LINE, alpha=0.5, lw=0, label="white noise, 95 %")
    axis.axhline(0, color=MUTED, lw=0.7)
    axis.vlines(np.arange(1, values.size + 1), 0, values, color=BLUE, lw=1.6)
    axis.set(xlabel="lag (samples)", ylabel="autocorrelation", title="Autocorrelation of the residuals")
    axis.set_ylim(min(-2 * band, float(np.min(values))), max(2 * band, float(np.max(values))))
    _legend(axis)
    return "Of white noise, 95 of 100 bars stay within the band."


def _forest(figure: Any, shown: Mapping[str, Any]) -> str:
    methods = [method for method in shown["methods"] if any(name in method["values"] for name in shown["compared"])]
    names = [name for name in shown["compared"] if any(name in method["values"] for method in methods)]
    if not names:
        return ""
    figure.set_size_inches(SIZE[0], 1.3 + 0.24 * len(methods))
    axes = figure.subplots(1, len(names), sharey=True, squeeze=False)[0]
    for axis, name in zip(axes, names, strict=True):
        _intervals(axis, name, methods[::-1], shown["values"].get(name))
    axes[0].set_yticks(range(len(methods)), [method["method"] for method in methods[::-1]], fontsize=9)
    axes[0].set_ylim(-0.7, len(methods) - 0.3)
    return (
        "95 % intervals: thin of a repeat, thick of this record; grey: the primary method's. Blue agrees with it, grey "
        "bars are tied with it, orange is off: neither interval covers the other's value. Arrow heads: beyond the plot."
    )


def _intervals(axis: Any, name: str, methods: Sequence[Mapping[str, Any]], reference: Mapping[str, Any] | None) -> None:
    """Draw the intervals of a quantity, one above the other, as far as the primary's lets them be seen."""
    from matplotlib.ticker import MaxNLocator

    rows = [(i, method, method["values"][name]) for i, method in enumerate(methods) if name in method["values"]]
    ends = [own[end] for _, _, own in rows for end in ("low", "high") if math.isfinite(own[end])] or [0.0, 1.0]
    low, high = min(ends), max(ends)
    if reference is not None and math.isfinite(width := reference["high"] - reference["low"]):
        low, high = max(low, reference["value"] - WIDTHS * width), min(high, reference["value"] + WIDTHS * width)
        axis.axvspan(max(reference["low"], low), min(reference["high"], high), color=LINE, alpha=0.5, lw=0)
    margin = 0.06 * (high - low) or 0.1 * abs(high) or 1.0
    low, high = low - margin, high + margin
    for i, method, own in rows:
        colour = AGREEMENT[method["agreement"].get(name, "-")]
        for of, width in (("", 1.8), ("record_", 4.0)):
            axis.plot(np.clip([own[f"{of}low"], own[f"{of}high"]], low, high), [i, i], color=colour, lw=width)
        marker = "<" if own["value"] < low else ">" if own["value"] > high else "o"
        axis.plot(np.clip(own["value"], low, high), i, marker, color=colour, ms=4.5, clip_on=False)
    unit = rows[0][2]["unit"]
    axis.set_title(readable(name) + ("" if unit == "-" else f" ({unit})"))
    axis.set_xlim(low, high)
    axis.xaxis.set_major_locator(MaxNLocator(4))
    axis.ticklabel_format(axis="x", useOffset=False, style="plain")
    axis.tick_params(axis="y", length=0)
    axis.grid(axis="x", lw=0.5)
    axis.set_axisbelow(True)
