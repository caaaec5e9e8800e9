"""The page's own pictures, by matplotlib, as small inline SVGs that take their colours from the page."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bench.pages.gather import ERROR, Panel, label_of
from bench.pages.headline import Answer
from bench.pages.kept import Kept, kept, stated_interval
from bench.pages.words import quantity, title_of
from bench.reference import REFERENCES
from bench.store import Store, StoredCell

INK, MUTED, LINE, SURFACE = "#010203", "#040506", "#070809", "#0a0b0c"
SERIES = ("#0d0e01", "#0d0e02", "#0d0e03", "#0d0e04")
COLOURS = {INK: "--ink", MUTED: "--muted", LINE: "--line", SURFACE: "--surface"} | {
    colour: f"--s{i}" for i, colour in enumerate(SERIES, 1)
}
"""Stand-ins in a picture, and the page's colours that take their place, one set for light and one for dark."""
STYLES = ("-", "--", "-.", ":")
MARKERS = ("o", "s", "^", "D")
POINTS = 180
MOST_FITS = 4
RC = {
    "svg.fonttype": "none", "text.color": INK, "axes.edgecolor": MUTED, "axes.labelcolor": INK, "xtick.color": MUTED,
    "ytick.color": MUTED, "grid.color": LINE, "axes.spines.right": False, "legend.frameon": False, "font.size": 10,
    "path.simplify_threshold": 0.3, "axes.titlesize": 10, "axes.titlelocation": "left", "savefig.transparent": True,
    "text.parse_math": False, "axes.spines.top": False, "svg.hashsalt": "vibration-bench", "font.family": "DejaVu Sans",
}  # fmt: skip


def pyplot() -> Any:
    """matplotlib's pyplot without a display."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot


def svg(figure: Any, title: str, name: str) -> str:
    """A figure as an inline SVG element of its own name space, without what HTML does not need."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    pyplot().close(figure)
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->|<style.*?</style>", "", text, flags=re.S)
    text = re.sub(r' (?:d|x|y|transform|points)="[^"]*"', lambda m: re.sub(r"(\d\.\d)\d+", r"\1", m.group(0)), text)
    text = re.sub(r"font: [^;\"]*?(\d+(?:\.\d+)?)px[^;\"]*", r"font-size: \1px", text)
    text = re.sub(r" font-family: [^;\"]*;|; stroke-linejoin: miter| transform=\"rotate\(-?0 [^\"]*\"", "", text)
    text = text.replace("xlink:href", "href").replace("; stroke-linecap: square", "")
    for stand_in, variable in COLOURS.items():
        text = text.replace(stand_in, f"var({variable})")
    used = set(re.findall(r'(?:href="#|url\(#)([^")]+)', text))
    text = re.sub(r' id="([^"]*)"', lambda m: f' id="{name}-{m.group(1)}"' if m.group(1) in used else "", text)
    text = re.sub(r'(href="#|url\(#)', rf"\g<1>{name}-", text)
    text = re.sub(r"\s*\n\s*(?=[LMCQzZ\"])", "", re.sub(r"[ \t]*\n\s*", "\n", text))
    text = re.sub(r"([LMCQ]) ", r"\1", re.sub(r"<defs>\s*</defs>\n?", "", text)).strip()
    size = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', text)
    box = f'viewBox="0 0 {size.group(1)} {size.group(2)}"' if size else ""
    return re.sub(r"<svg[^>]*>", f'<svg {box} role="img" aria-label="{_plain(title)}">', text, count=1)


def _plain(text: str) -> str:
    return text.replace("&", "and").replace("<", "").replace(">", "").replace('"', "")


def draw_answers(answers: Sequence[Answer]) -> str:
    """How many times the smallest possible error each method makes: a line a method, a panel a reading of the start."""
    plt = pyplot()
    with plt.rc_context(RC):
        metrics = list(dict.fromkeys(m for one in answers for m in one.panel.ranked))[: len(SERIES)]
        cells = {label_of(c) for one in answers for c in one.panel.methods}
        order = sorted(cells, key=lambda label: -_worst(answers, label, metrics))
        height = 1.1 + 0.26 * len(order)
        figure, axes = plt.subplots(
            1, len(answers), figsize=(8.2, height), sharey=True, squeeze=False, layout="constrained"
        )
        for axis, one in zip(axes[0], answers, strict=True):
            own = {label_of(cell): cell for cell in one.panel.methods}
            axis.axvline(1.0, color=INK, lw=1)
            for j, metric in enumerate(metrics):
                found = [
                    (own[label].summary.get(metric, {}).get("excess", math.nan), y)
                    for y, label in enumerate(order)
                    if label in own
                ]
                points = [(x, y) for x, y in found if math.isfinite(x)]
                axis.plot(
                    [x for x, _ in points], [y for _, y in points], MARKERS[j], color=SERIES[j], ms=6, mfc="none",
                    mew=1.6, label=quantity(metric),
                )  # fmt: skip
            axis.set(xscale="log", title=f"start {one.panel.told}", xlabel="error over the smallest possible")
            low, high = axis.get_xlim()
            ticks = [t for t in (0.5, 1, 2, 3, 5, 10, 20, 50, 100, 200, 500) if low <= t <= high]
            axis.set_xticks(ticks, [f"{t:g}" for t in ticks])
            axis.minorticks_off()
            axis.set_ylim(-0.6, len(order) - 0.4)
            axis.set_yticks(range(len(order)), [title_of(label) for label in order])
            axis.grid(axis="both", lw=0.6)
            axis.set_axisbelow(True)
            axis.tick_params(length=0)
        handles, labels = axes[0][0].get_legend_handles_labels()
        if handles:
            figure.legend(handles, labels, loc="outside upper right", ncols=len(metrics))
        return svg(figure, "Error of every method over the smallest possible, by quantity", "answers")


def _worst(answers: Sequence[Answer], label: str, metrics: Sequence[str]) -> float:
    found = [
        cell.summary[m]["excess"]
        for one in answers
        for cell in one.panel.methods
        for m in metrics
        if label_of(cell) == label and m in cell.summary
    ]
    finite = [x for x in found if math.isfinite(x)]
    return sum(math.log(max(x, 1e-3)) for x in finite) / len(finite) if finite else math.inf


def draw_panel(store: Store, panel: Panel, name: str) -> tuple[str, tuple[str, ...]]:
    """One scenario: samples, truth and fits, their errors, and intervals; and the methods without a fit to draw."""
    found = {label_of(cell): (cell, kept(store, cell)) for cell in panel.methods}
    fits = {label: (cell, k) for label, (cell, k) in found.items() if k is not None and k.fit is not None}
    any_kept = next((k for _, k in found.values() if k is not None), None)
    if any_kept is None:
        return "", tuple(found)
    chosen = _chosen(fits)
    plt = pyplot()
    with plt.rc_context(RC):
        figure = plt.figure(figsize=(10.2, max(4.6, 1.6 + 0.21 * len(found) * 2)), layout="constrained")
        metrics = [m for m in panel.ranked if m != "rmse"][:2]
        grid = figure.add_gridspec(2, 2 if metrics else 1, width_ratios=(1.1, 1) if metrics else None)
        _draw_record(figure.add_subplot(grid[0, 0]), any_kept, [(label, fits[label][1]) for label in chosen])
        _draw_errors(figure.add_subplot(grid[1, 0]), panel, [(label, fits[label][1]) for label in chosen])
        inner = grid[:, 1].subgridspec(len(metrics), 1) if metrics else None
        for i, metric in enumerate(metrics):
            assert inner is not None
            _draw_intervals(figure.add_subplot(inner[i, 0]), store, panel, metric)
        return svg(figure, f"Record, fits and intervals: {panel.title()}", name), tuple(
            label for label in found if label not in fits
        )


def _chosen(fits: Mapping[str, tuple[StoredCell, Kept | None]]) -> list[str]:
    """A few that differ: the least and the largest error of the displacement, and evenly between."""
    order = sorted(fits, key=lambda label: (_median(fits[label][0]), label))
    if len(order) <= MOST_FITS:
        return order
    picks = [round(i * (len(order) - 1) / (MOST_FITS - 1)) for i in range(MOST_FITS)]
    return [order[i] for i in picks]


def _median(cell: StoredCell) -> float:
    value = cell.summary.get("rmse", {}).get("median", math.inf)
    return math.inf if math.isnan(value) else value


def _thin(values: np.ndarray) -> np.ndarray:
    return values[np.unique(np.linspace(0, len(values) - 1, POINTS).round().astype(int))]


def _draw_record(axis: Any, one: Kept, fits: Sequence[tuple[str, Kept | None]]) -> None:
    axis.plot(_thin(one.dense), _thin(one.truth), color=LINE, lw=5, solid_capstyle="round", label="truth")
    for j, (label, k) in enumerate(fits):
        if k is not None and k.fit is not None:
            axis.plot(_thin(k.dense), _thin(k.fit), STYLES[j], color=SERIES[j], lw=1.3, label=title_of(label))
    axis.plot(one.times[:200], one.values[:200], "o", color=INK, ms=3.5, label="samples")
    where = f" of mass {one.dof + 1} of {one.dofs}" if one.dofs > 1 else ""
    axis.set(ylabel=f"displacement{where} (m)", title="First data set: samples, truth and fits")
    reach = 1.2 * max(np.max(np.abs(one.truth)), np.max(np.abs(one.values)))
    axis.set_ylim(-reach, 1.75 * reach)
    axis.legend(loc="upper right", ncols=2, fontsize=8.5, borderaxespad=0)
    axis.grid(lw=0.5)


def _draw_errors(axis: Any, panel: Panel, fits: Sequence[tuple[str, Kept | None]]) -> None:
    sigma = (panel.what.get("sigma") or [math.nan])[0]
    if math.isfinite(sigma):
        axis.axhspan(-sigma, sigma, color=LINE, alpha=0.45, lw=0, label="noise of a sample, ± 1 sd")
    for j, (label, k) in enumerate(fits):
        if k is None or k.fit is None:
            continue
        error = k.fit - k.truth
        axis.plot(_thin(k.dense), _thin(error), STYLES[j], color=SERIES[j], lw=1.2)
        if j == 0:
            if k.band is not None:
                inside = [_thin(error + side * 2 * k.band) for side in (-1, 1)]
                axis.fill_between(_thin(k.dense), *inside, color=SERIES[j], alpha=0.15, lw=0)
            residual = k.values - np.interp(k.times, k.dense, k.fit)
            axis.plot(
                k.times[:200], residual[:200], "o", color=INK, ms=3, mfc="none", mew=0.9,
                label=f"samples less {title_of(label)}",
            )  # fmt: skip
    axis.set(
        xlabel="time (s)", ylabel="difference (m)", title="Fits less truth (lines), residuals of samples (circles)"
    )
    axis.legend(loc="upper right", fontsize=8.5, borderaxespad=0)
    axis.grid(lw=0.5)
    low, high = axis.get_ylim()
    axis.set_ylim(low, high + 0.3 * (high - low))


def _draw_intervals(axis: Any, store: Store, panel: Panel, metric: str) -> None:
    """Deviation from the truth by method: the middle 95 % of all data sets, the first one's value and interval."""
    name = metric.removesuffix(ERROR)
    cells = sorted(panel.cells, key=lambda c: (c.cell.get("method") not in REFERENCES, -_error(c, metric), label_of(c)))
    bound = next((c.summary[metric]["bound"] for c in cells if metric in c.summary), math.nan)
    if math.isfinite(bound):
        axis.axvspan(-1.96 * bound, 1.96 * bound, color=LINE, alpha=0.45, lw=0)
    axis.axvline(0, color=INK, lw=0.8)
    cells = [c for c in cells if metric in c.summary and c.cell.get("method") != "prior"]
    spreads: dict[int, tuple[float, float]] = {}
    stated: list[float] = []
    for y, cell in enumerate(cells):
        ratios = np.array([row.scores[f"{name}_ratio"] for row in cell.rows if f"{name}_ratio" in row.scores], float)
        ratios = ratios[np.isfinite(ratios)]
        if not ratios.size:
            continue
        low, high = 100 * (np.percentile(ratios, (2.5, 97.5)) - 1)
        spreads[y] = (float(low), float(high))
        axis.plot([low, high], [y + 0.14] * 2, color=SERIES[0], lw=3.2, solid_capstyle="butt")
        first = cell.rows[0].scores.get(f"{name}_ratio", math.nan)
        interval = stated_interval(store, cell, name)
        if interval is not None:
            ends = [100 * (v - 1) for v in interval]
            stated.append(max(-ends[0], ends[1]))
            axis.plot(ends, [y - 0.2] * 2, color=SERIES[1], lw=1.2)
        axis.plot(100 * (first - 1), y - 0.2, "o", color=SERIES[1], ms=3.5)
    if spreads:
        reach = 1.1 * max(_most([max(-low, high) for low, high in spreads.values()]), _most(stated), 2 * _nil(bound))
        axis.set_xlim(-reach, reach)
        for y, (low, high) in spreads.items():  # what lies beyond the edge is said, not left out in silence
            if low < -reach or high > reach:
                says = f"{low:.2g} to {high:.2g}".replace("-", "−")
                axis.text(1.01, y, says, transform=axis.get_yaxis_transform(), va="center", fontsize=7.5, color=MUTED)
    axis.set_yticks(range(len(cells)), [title_of(label_of(c)) for c in cells], fontsize=8.5)
    axis.set_ylim(-0.7, len(cells) - 0.2)
    axis.set(title=f"{quantity(metric)}: off the truth (%)")
    axis.tick_params(axis="y", length=0)


def _most(widths: Sequence[float]) -> float:
    """What three of four stay within."""
    ordered = sorted(width for width in widths if math.isfinite(width))
    return ordered[(3 * (len(ordered) - 1)) // 4] if ordered else 0.0


def _nil(value: float) -> float:
    return value if math.isfinite(value) and value > 0 else 0.5


def _error(cell: StoredCell, metric: str) -> float:
    value = cell.summary.get(metric, {}).get("excess", math.nan)
    return value if math.isfinite(value) else 1e9
