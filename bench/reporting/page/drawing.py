"""The page's own pictures, by matplotlib, as small inline SVGs that take their colours from the page."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bench.reporting.frame import ERROR, Result
from bench.reporting.labels import title as title_of
from bench.reporting.page.first_replicate import FirstReplicate, first_replicate, stated_interval
from bench.reporting.page.headline import Answer
from bench.reporting.page.reading import Panel
from bench.reporting.page.words import quantity
from bench.store.store import Store

INK, MUTED, LINE, SURFACE = "#010203", "#040506", "#070809", "#0a0b0c"
SERIES = ("#0d0e01", "#0d0e02", "#0d0e03", "#0d0e04")
COLOURS = {INK: "--ink", MUTED: "--muted", LINE: "--line", SURFACE: "--surface"} | {
    colour: f"--s{i}" for i, colour in enumerate(SERIES, 1)
}
"""Stand-ins in a picture, and the page's colours that take their place, one set for light and one for dark."""
STYLES = ("-", "--", "-.", ":")
MARKERS = ("o", "s", "^", "D")
POINTS = 100
MOST_FITS = 4
MOST_ABOVE = 3.0
"""A fit whose typical error is more times the least is not drawn over the record: it would hide the others."""
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


def row_axis(axis: Any) -> None:
    """Draw an axis whose rows have names: no ticks there, and a grid of values behind what is drawn."""
    axis.tick_params(axis="y", length=0)
    axis.grid(axis="x", lw=0.5)
    axis.set_axisbelow(True)


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
    text = re.sub(r'(href="#|url\(#)', lambda m: f"{m.group(1)}{name}-", text)
    text = re.sub(r"\s*\n\s*(?=[LMCQzZ\"])", "", re.sub(r"[ \t]*\n\s*", "\n", text))
    text = re.sub(r"([LMCQ]) ", r"\1", re.sub(r"<defs>\s*</defs>\n?", "", text)).strip()
    size = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', text)
    box = f'viewBox="0 0 {size.group(1)} {size.group(2)}"' if size else ""
    start = f'<svg {box} role="img" aria-label="{_plain(title)}">'
    return re.sub(r"<svg[^>]*>", lambda _: start, text, count=1)  # as it is: a title may hold what a template reads


def _plain(text: str) -> str:
    return text.replace("&", "and").replace("<", "").replace(">", "").replace('"', "")


def chance_band(n: int) -> tuple[float, float]:
    """Where the root mean square of ``n`` normal errors over its expectation lies in 95 % of cases, by its limit.

    The mean of n squares of standard normal numbers has variance 2/n, its root about 1/(2n).
    """
    half = 1.96 * math.sqrt(1.0 / (2.0 * n))
    return 1.0 - half, 1.0 + half


def draw_answers(answers: Sequence[Answer]) -> list[str]:
    """How many times the smallest possible error each method makes: a picture a reading of the start, of one scale."""
    plt = pyplot()
    metrics = list(dict.fromkeys(m for one in answers for m in one.panel.ranked))[: len(SERIES)]
    shown = [cell.excess(m) for one in answers for cell in one.panel.methods for m in metrics]
    finite = [value for value in shown if math.isfinite(value) and value > 0] or [1.0]
    limits = (0.85 * min(0.9, *finite), 1.2 * max(2.0, *finite))
    pictures = []
    for i, one in enumerate(answers):
        start = f"start {one.panel.facts.initial_state}"
        cells = sorted(one.panel.methods, key=lambda cell: (-_typical(cell, metrics), cell.label))
        most = max((cell.n for cell in cells), default=1)
        with plt.rc_context(RC):
            figure, axis = plt.subplots(figsize=(5.0, 1.3 + 0.26 * len(cells)), layout="constrained")
            axis.axvspan(*np.clip(chance_band(most), limits[0], None), color=LINE, alpha=0.45, lw=0)
            axis.axvline(1.0, color=INK, lw=1)
            for j, metric in enumerate(metrics):
                axis.plot(
                    [cell.excess(metric) for cell in cells], range(len(cells)), MARKERS[j], color=SERIES[j], ms=6,
                    mfc="none", mew=1.6, label=quantity(metric),
                )  # fmt: skip
            axis.set(
                xscale="log",
                title=start,
                xlabel="error over the smallest possible",
                xlim=limits,
            )
            ticks = [t for t in (0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500) if limits[0] <= t <= limits[1]]
            axis.set_xticks(ticks, [f"{t:g}" for t in ticks])
            axis.minorticks_off()
            axis.set_ylim(-0.6, len(cells) - 0.4)
            few = ["" if cell.n == most else f" (n = {cell.n})" for cell in cells]
            names = [cell.title + n for cell, n in zip(cells, few, strict=True)]
            axis.set_yticks(range(len(cells)), names)
            axis.grid(axis="both", lw=0.6)
            axis.set_axisbelow(True)
            axis.tick_params(length=0)
            if metrics:
                figure.legend(loc="outside upper left", ncols=len(metrics), fontsize=9, handletextpad=0.2)
            title = f"Error of every method over the smallest possible, {start}"
            pictures.append(svg(figure, title, f"answers{i}"))
    return pictures


def _typical(cell: Result, metrics: Sequence[str]) -> float:
    """The mean logarithm of a method's errors over the bound: what the picture is sorted by."""
    finite = [x for x in (cell.excess(metric) for metric in metrics) if math.isfinite(x)]
    return sum(math.log(max(x, 1e-3)) for x in finite) / len(finite) if finite else math.inf


def draw_panel(store: Store, panel: Panel, name: str) -> tuple[str, tuple[str, ...]]:
    """One scenario: samples, truth and fits, their errors, and intervals; and the methods without a fit to draw."""
    found = {cell.label: (cell, first_replicate(store, cell)) for cell in panel.methods}
    fits = {label: (cell, k) for label, (cell, k) in found.items() if k is not None and k.fit is not None}
    any_kept = next((k for _, k in found.values() if k is not None), None)
    if any_kept is None:
        return "", tuple(found)
    chosen = _chosen(fits)
    plt = pyplot()
    with plt.rc_context(RC):
        metrics = _one_of_each(panel.ranked)
        rows = sum(len(_with_ratios(panel, metric)) for metric in metrics)
        figure = plt.figure(figsize=(10.2, max(4.6, 1.2 + 0.2 * rows + 0.3 * len(metrics))), layout="constrained")
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


def _one_of_each(ranked: Sequence[str]) -> list[str]:
    """Of the quantities that the data tell, the first mass, damping and stiffness (or their ratios to a mass)."""
    first = {name[0]: name for name in reversed(ranked) if name != "rmse"}
    return [name for name in ranked if name in first.values()][:3]


def _chosen(fits: Mapping[str, tuple[Result, FirstReplicate | None]]) -> list[str]:
    """A few that differ: the least error of the displacement, one not far above it, and evenly between."""
    order = sorted(fits, key=lambda label: (_median(fits[label][0]), label))
    order = [label for label in order if _median(fits[label][0]) <= MOST_ABOVE * _median(fits[order[0]][0])]
    if len(order) <= MOST_FITS:
        return order
    picks = [round(i * (len(order) - 1) / (MOST_FITS - 1)) for i in range(MOST_FITS)]
    return [order[i] for i in picks]


def _median(cell: Result) -> float:
    value = cell.statistic("rmse", "median")
    return math.inf if math.isnan(value) else value


def _thin(values: np.ndarray) -> np.ndarray:
    return values[np.unique(np.linspace(0, len(values) - 1, POINTS).round().astype(int))]


def _draw_record(axis: Any, one: FirstReplicate, fits: Sequence[tuple[str, FirstReplicate | None]]) -> None:
    axis.plot(_thin(one.dense), _thin(one.truth), color=LINE, lw=5, solid_capstyle="round", label="truth")
    for j, (label, k) in enumerate(fits):
        if k is not None and k.fit is not None:
            axis.plot(_thin(k.dense), _thin(k.fit), STYLES[j], color=SERIES[j], lw=1.3, label=title_of(label))
    axis.plot(one.times[:200], one.values[:200], "o", color=INK, ms=3.5, label="samples")
    where = f", mass {one.dof + 1} of {one.dofs}" if one.dofs > 1 else ""
    axis.set(ylabel="displacement (m)", title=f"First data set{where}: samples, truth and fits")
    reach = 1.2 * max(np.max(np.abs(one.truth)), np.max(np.abs(one.values)))
    axis.set_ylim(-reach, 1.75 * reach)
    axis.legend(loc="upper right", ncols=2, fontsize=8.5, borderaxespad=0)
    axis.grid(lw=0.5)


def _draw_errors(axis: Any, panel: Panel, fits: Sequence[tuple[str, FirstReplicate | None]]) -> None:
    sigma = (panel.facts.sigma or (math.nan,))[0]
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
                said = f"{title_of(label)}, ± 2 stated sd"
                axis.fill_between(_thin(k.dense), *inside, color=SERIES[j], alpha=0.15, lw=0, label=said)
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
    axis.set_ylim(low, high + 0.4 * (high - low))


def _ratios(cell: Result, metric: str) -> np.ndarray:
    """The finite values of a quantity over its true one, of the fits that have it."""
    values = cell.scores(f"{metric.removesuffix(ERROR)}_ratio")
    return np.asarray(values[np.isfinite(values)])


def _with_ratios(panel: Panel, metric: str) -> list[Result]:
    """The cells that have any value of a quantity, worst first, references at the bottom; not the prior's."""
    found = [c for c in panel.results if c.method != "prior" and _ratios(c, metric).size]
    return sorted(found, key=lambda c: (not c.is_reference, -_error(c, metric), c.label))


def _draw_intervals(axis: Any, store: Store, panel: Panel, metric: str) -> None:
    """Deviation from the truth by method: the middle 95 % of all data sets, the first one's value and interval."""
    name = metric.removesuffix(ERROR)
    cells = _with_ratios(panel, metric)
    bound = next((c.bound(metric) for c in cells if metric in c.summary), math.nan)
    if math.isfinite(bound):
        axis.axvspan(-1.96 * bound, 1.96 * bound, color=LINE, alpha=0.45, lw=0)
    axis.axvline(0, color=INK, lw=0.8)
    spreads = [100 * (np.percentile(_ratios(cell, metric), (2.5, 97.5)) - 1) for cell in cells]
    intervals = [stated_interval(store, cell, name) for cell in cells]
    stated = [None if ends is None else 100 * (np.array(ends) - 1) for ends in intervals]
    widths = [[np.max(np.abs(ends)) for ends in many if ends is not None] for many in (spreads, stated)]
    reach = 1.1 * max(*map(_most, widths), 2 * _nil(bound))
    for y, (cell, spread, ends) in enumerate(zip(cells, spreads, stated, strict=True)):
        axis.plot(spread, [y + 0.14] * 2, color=SERIES[0], lw=3.2, solid_capstyle="butt")
        _mark_beyond(axis, y + 0.14, spread, reach, SERIES[0])
        _say_beyond(axis, y, spread, reach)
        first = 100 * (cell.first(f"{name}_ratio") - 1)
        if ends is not None:
            axis.plot(ends, [y - 0.2] * 2, color=SERIES[1], lw=1.2)
        _mark_beyond(axis, y - 0.2, [first] if ends is None else ends, reach, SERIES[1])
        axis.plot(first, y - 0.2, "o", color=SERIES[1], ms=3.5)
    axis.set_xlim(-reach, reach)
    axis.set_yticks(range(len(cells)), [c.title for c in cells], fontsize=8.5)
    axis.set_ylim(-0.7, len(cells) - 0.2)
    axis.set(title=f"{quantity(metric)}: off the truth (%)")
    axis.tick_params(axis="y", length=0, pad=6)


def _mark_beyond(axis: Any, y: float, ends: Sequence[float] | np.ndarray, reach: float, colour: str) -> None:
    """An arrow head at the edge that a bar goes beyond."""
    for side, marker in ((-1, "<"), (1, ">")):
        if max(side * end for end in ends) > reach:
            axis.plot(side * reach, y, marker, color=colour, ms=4, clip_on=False)


def _say_beyond(axis: Any, y: float, spread: np.ndarray, reach: float) -> None:
    """What a bar that goes beyond an edge runs from and to: at that edge if none of it is seen, else on the right."""
    low, high = spread
    if low >= -reach and high <= reach:
        return
    says = f"{low:.2g} to {high:.2g}".replace("-", "−")
    if low > reach or high < -reach:
        side = 1 if low > reach else -1
        axis.text(
            0.95 * side * reach, y, says, ha="right" if side > 0 else "left", va="center", fontsize=7.5, color=MUTED
        )
    else:
        arrow = "↔" if low < -reach and high > reach else "←" if low < -reach else "→"
        axis.text(
            1.02, y, f"{arrow} {says}", transform=axis.get_yaxis_transform(), va="center", fontsize=7.5, color=MUTED
        )


def _most(widths: Sequence[float]) -> float:
    """What three of four stay within."""
    ordered = sorted(width for width in widths if math.isfinite(width))
    return ordered[(3 * (len(ordered) - 1)) // 4] if ordered else 0.0


def _nil(value: float) -> float:
    return value if math.isfinite(value) and value > 0 else 0.5


def _error(cell: Result, metric: str) -> float:
    value = cell.excess(metric)
    return value if math.isfinite(value) else 1e9
