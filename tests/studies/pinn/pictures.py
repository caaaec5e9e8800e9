"""The benchmark's pictures, from its stored numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bench.reporting.figures.style import FULL, MM, legend_below, looks, pyplot, save_figure
from tests.studies.pinn.common import METHODS

LABELS = {
    "pinn": "PINN (Levenberg-Marquardt)",
    "pinn_adam": "PINN (paper's training)",
    "collocation": "spline collocation",
    "shooting": "multiple shooting",
}


def loss_picture(data: dict[str, Any], out: Path) -> list[Path]:
    """The paper's Figure 6, for both trainings."""
    plt = pyplot()
    figure, axes = plt.subplots(1, 3, figsize=(FULL, 58.0 * MM), layout="constrained")
    for name, own in data.items():
        evaluations = np.array(own["evaluations"]) + 1.0
        style = {"color": looks([name])[name].colour, "label": LABELS[name]}
        axes[0].loglog(evaluations, own["loss"], **style)
        axes[1].loglog(evaluations, own["mean_square_data"], **style)
        axes[2].loglog(evaluations, _positive(own["mean_square_physics"]), **style)
    titles = ("loss, at its final weights (−)", "data, mean square (−)", "equation of motion, mean square (−)")
    for axis, title in zip(axes, titles, strict=True):
        axis.set_title(title)
        axis.set_xlabel("evaluations of all residuals")
    legend_below(figure, axes[0].get_legend_handles_labels()[0])
    return save_figure(figure, out, "pinn_loss")


def _positive(values: list[float]) -> np.ndarray:
    """The values, those that are zero left out: the state of rest that both start from solves the equation."""
    array = np.array(values)
    return np.where(array > 0, array, np.nan)


TOP = 2.0
"""The largest ratio of errors that is drawn; what is larger is a triangle at the edge."""


def _shown(axis: Any, sizes: np.ndarray, values: np.ndarray, colour: str) -> np.ndarray:
    """The values, those beyond the edge marked there and left out."""
    beyond = ~(values <= TOP)
    if beyond.any():
        axis.plot(sizes[beyond], np.full(beyond.sum(), 0.96 * TOP), "^", color=colour, ms=6)
    return np.where(beyond, np.nan, values)


def scaling_picture(data: dict[str, Any], out: Path) -> list[Path]:
    """Seconds a fit, and error over the oracle's, against size."""
    plt = pyplot()
    labels = {"residuals": "residuals", "masses": "masses in the chain", "cycles": "cycles in the record"}
    figure, axes = plt.subplots(2, 3, figsize=(FULL, 92.0 * MM), layout="constrained", sharex="col", sharey="row")
    for column, (kind, label) in enumerate(labels.items()):
        for name in METHODS:
            own = [point for point in data[kind] if point["method"] == name]
            look = looks([name])[name]
            size = [point["size"] for point in own]
            for row, what in enumerate(("seconds", "ratio")):
                values = np.array([point[what] for point in own], float)
                if what == "ratio":
                    values = _shown(axes[row, column], np.array(size, float), values, look.colour)
                axes[row, column].plot(size, values, color=look.colour, marker=look.marker, ms=4, label=LABELS[name])
        axes[1, column].axhline(1.0, color="0.7", lw=0.8)
        axes[1, column].set_xlabel(label)
        axes[0, column].set_yscale("log")
        ticks = sorted({point["size"] for point in data[kind]})
        axes[1, column].set_xscale("log")
        axes[1, column].minorticks_off()
        axes[1, column].set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes[1, 0].set_ylim(0.0, TOP)
    axes[0, 0].set_ylabel("time of a fit (s)")
    axes[1, 0].set_ylabel("errors / oracle's (−)")
    legend_below(figure, axes[0, 1].get_legend_handles_labels()[0])
    return save_figure(figure, out, "pinn_scaling")
