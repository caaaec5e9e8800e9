"""The benchmark's pictures with their captions, from its stored numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench.reporting.figures.style import (
    FULL,
    MM,
    Look,
    handle,
    legend_below,
    looks,
    panels,
    plain_logarithmic,
    pyplot,
    save_figure,
)
from tests.studies.pinn.common import METHODS

TERMS = {
    "loss": "loss, at its final weights (−)",
    "mean_square_data": "data, mean square (−)",
    "mean_square_physics": "equation of motion, mean square (−)",
}
SIZES = {"residuals": "residuals (−)", "masses": "masses in the chain (−)", "cycles": "cycles in the record (−)"}
LEAST, TOP = 0.7, 1.5
"""Limits of the ratios of errors that are drawn; a triangle at the edge stands for one beyond."""


# ------------------------------------------------------------------------------------------------ the loss


def loss_picture(data: dict[str, Any], out: Path) -> list[Path]:
    """Draw the loss and its terms along both trainings, the paper's Figure 6; the files."""
    found = looks(data)
    figure, axes = panels(len(TERMS), 3, 46.0, "evaluations of all residuals (−)")
    for axis, (term, title) in zip(axes, TERMS.items(), strict=True):
        for name, own in data.items():
            values = np.array(own[term], float)
            values = np.where(values > 0, values, np.nan)  # rest, from which both start, solves the equation
            axis.plot(np.array(own["evaluations"]) + 1.0, values, color=found[name].colour, lw=1.2)
        axis.set(xscale="log", yscale="log")
        axis.set_title(title, loc="left")
        plain_logarithmic(axis.xaxis)
        plain_logarithmic(axis.yaxis)
        axis.grid()
    legend_below(figure, [handle(look, marker=None) for look in found.values()])
    return save_figure(figure, out, "pinn_loss", loss_caption(data))


def loss_caption(data: Mapping[str, Mapping[str, Sequence[float]]]) -> str:
    """Return the caption of the picture of the loss."""
    found = looks(data)
    ends = {name: (int(own["evaluations"][-1]) + 1, own["loss"][-1]) for name, own in data.items()}
    soonest = min(ends, key=lambda name: ends[name][0])
    others = "".join(
        f", {look.title} after {ends[name][0]}" for name, look in found.items() if name != soonest and name in ends
    )
    lead = f"{found[soonest].title} ends after {ends[soonest][0]} evaluations{others}"
    losses = "; ".join(f"{look.title} {ends[name][1]:.4g}" for name, look in found.items())
    return (
        f"{lead}. Both trainings minimise the same loss of the same network on the same record, from the same start. "
        "Left: that loss, minus the log posterior at the final weights. Then the mean square of two of its terms, in "
        "units of the record (its duration and root mean square). A line begins late where a term is nil at first. "
        f"Loss at the end: {losses}. The paper's Figure 6 shows the whole loss alone."
    )


# ------------------------------------------------------------------------------------------------ size


def scaling_picture(data: dict[str, Any], out: Path) -> list[Path]:
    """Draw seconds a fit, and error over the oracle's, against size; the files."""
    figure, axes = pyplot().subplots(
        2, len(SIZES), figsize=(FULL, 88.0 * MM), layout="constrained", sharex="col", sharey="row"
    )
    found = looks(METHODS)
    for column, (kind, label) in enumerate(SIZES.items()):
        for number, look in enumerate(found.values()):
            own = [point for point in data[kind] if point["method"] == look.label]
            size = np.array([point["size"] for point in own], float)
            point = {**look.point(7.0 - 2.0 * number, hollow=True), "mew": 1.0}  # one in another where they agree
            seconds, ratio = (np.array([point[what] for point in own], float) for what in ("seconds", "ratio"))
            axes[0, column].plot(size, seconds, color=look.colour, lw=1.0, **point)
            axes[1, column].plot(size, _shown(axes[1, column], size, ratio, look), color=look.colour, lw=1.0, **point)
        axes[1, column].axhline(1.0, color="0.7", lw=0.8, zorder=0)
        axes[1, column].set(xscale="log", xlabel=label, ylim=(LEAST, TOP))
        axes[0, column].set_yscale("log")
        axes[1, column].minorticks_off()
        ticks = sorted({point["size"] for point in data[kind]})
        axes[1, column].set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        for axis in axes[:, column]:
            axis.grid()
    plain_logarithmic(axes[0, 0].yaxis)
    axes[0, 0].set_ylabel("time of a fit (s)")
    axes[1, 0].set_ylabel("errors / oracle's (−)")
    legend_below(figure, [handle(look, **look.point(4.5, hollow=True)) for look in found.values()])
    return save_figure(figure, out, "pinn_scaling", scaling_caption(data))


def _shown(axis: Any, sizes: np.ndarray, values: np.ndarray, look: Look) -> np.ndarray:
    """The values; one beyond the edge is left out, and marked there with its number."""
    beyond = ~((values >= LEAST) & (values <= TOP))
    for size, value in zip(sizes[beyond], values[beyond], strict=True):
        axis.plot(size, 0.97 * TOP, "^", color=look.colour, ms=5)
        text = f"{value:.0f}" if value > 100.0 else f"{value:.3g}"
        axis.annotate(text, (size, 0.97 * TOP), (-5, 0), textcoords="offset points", ha="right", va="center")
    return np.where(beyond, np.nan, values)


def scaling_caption(data: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """Return the caption of the picture of size."""
    found = looks(METHODS)
    every = [point for own in data.values() for point in own]
    largest = {look.title: max(p["ratio"] for p in every if p["method"] == look.label) for look in found.values()}
    said = "; ".join(
        f"{name} {ratio:.0f}" if ratio > 100.0 else f"{name} {ratio:.3g}" for name, ratio in largest.items()
    )
    shortest = min(point["size"] for point in data["cycles"])
    times = {p["method"]: p["seconds"] for p in data["cycles"] if p["size"] == shortest}
    slowest, fastest = max(times, key=times.__getitem__), min(times, key=times.__getitem__)
    return (
        f"A fit takes more time the larger the problem is, and {found[slowest].title} takes most. Upper row: "
        f"processor time of a fit; on the shortest record {found[slowest].title} takes "
        f"{times[slowest] / times[fastest]:.2g} times that of {found[fastest].title}. Lower row: root mean square "
        "error of the groups over that of the oracle, which starts from the truth, on the same data; 1 is as "
        f"accurate. Largest ratio: {said}. A triangle with a number is beyond the edge. Left: collocation points on "
        "the reference record, which only two methods have. Middle: chains, by the number of masses. Right: cycles in "
        "the record. A line ends where a fit would take minutes. Hollow markers lie one in another where methods "
        "agree."
    )
