"""The record, and what each method makes of it: the paper's Figures 4 and 5."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bench.contract.problem import Channel, Record
from bench.dynamics.simulate import fitted_start, simulate
from bench.reporting.figures.gallery import Gallery, Nothing, Picture, named, where
from bench.reporting.figures.style import HALF, MM, entry, legend_below, panels, pyplot, wrapped
from bench.reporting.frame import Result

TRUE = {"color": "0.6", "lw": 2.2, "label": "true response"}
SAMPLES = {"color": "black", "marker": "o", "ms": 2.6, "mfc": "white", "mew": 0.6, "linestyle": "none"}
Arrays = Mapping[str, np.ndarray]


def samples_of(arrays: Arrays, dof: int) -> tuple[np.ndarray, np.ndarray]:
    """Times (s) and values (m) of one DOF's samples in the first record."""
    own = arrays["sample_dof"] == dof
    return arrays["sample_times"][own], arrays["sample_values"][own]


def with_record(gallery: Gallery, cells: list[Result]) -> list[tuple[Result, dict[str, np.ndarray]]]:
    """The cells whose record is stored, with the arrays."""
    found = [(one, gallery.arrays(one)) for one in cells]
    found = [(one, arrays) for one, arrays in found if "true_displacement" in arrays and "sample_values" in arrays]
    if not found:
        raise Nothing("no arrays of a record are stored")
    return found


def draw_record(gallery: Gallery) -> Picture:
    """The samples of one replicate and the true response, a panel for each DOF with a sensor."""
    cell, arrays = with_record(gallery, gallery.scene(gallery.main, "known"))[0]
    dofs = sorted(set(arrays["sample_dof"].tolist()))
    n = len(dofs)
    figure, axes = pyplot().subplots(
        n, 1, figsize=(HALF, (12.0 + 42.0 * n) * MM), layout="constrained", squeeze=False, sharex=True
    )
    for i, (dof, axis) in enumerate(zip(dofs, axes[:, 0], strict=True)):
        axis.plot(arrays["dense_times"], arrays["true_displacement"][dof], **TRUE)
        times, values = samples_of(arrays, dof)
        sigma = cell.sigma[i] if i < len(cell.sigma) else None
        label = "samples" if sigma is None else "samples, bars of ± σ"
        axis.errorbar(times, values, sigma, **SAMPLES, elinewidth=0.7, label=label)
        axis.set_ylabel("displacement (m)" if len(arrays["true_displacement"]) == 1 else f"$x_{{{dof + 1}}}$ (m)")
        axis.grid()
    axes[-1, 0].set_xlabel("time (s)")
    legend_below(figure, axes[0, 0].get_legend_handles_labels()[0])
    size = int(np.sum(arrays["sample_dof"] == dofs[0]))
    of = "the displacement" if n == 1 else f"each of {n} displacements"
    return Picture(
        figure,
        f"The methods are given {size} noisy samples of {of} over {cell.duration:g} s. The grey line is the true "
        f"response, which no method sees ({where(cell)}; replicate 0). The bars are the noise's standard "
        "deviation σ, which no method is told either. The noise level is the same over the whole record, so the "
        "decayed part tells less. The paper's Figure 4 shows the same.",
    )


def point_parameters(cell: Result) -> dict[str, float] | None:
    """The parameters that a method found in replicate 0, from its scores: ratio times truth; None where not all are."""
    true = cell.parameters
    values = {name: cell.first(f"{name}_ratio") * float(value) for name, value in true.items()}
    return values if all(np.isfinite(value) for value in values.values()) else None


def simulated(cell: Result, arrays: Arrays) -> np.ndarray | None:
    """The free response of the parameters found, (n_dof, n_dense): what is scored where a method reconstructs nothing.

    From the start that was told, or the one that fits the samples best. None with a force, which is not stored.
    """
    p = point_parameters(cell)
    if p is None or cell.forced or cell.added_mass:
        return None
    system = cell.model
    dofs = sorted(set(arrays["sample_dof"].tolist()))
    channels = tuple(Channel(*samples_of(arrays, dof), dof=dof) for dof in dofs)
    start = cell.start_told or fitted_start(system, p, Record(channels, (), None))
    return np.asarray(simulate(system, p, start, arrays["dense_times"]).displacement)


def draw_reconstruction(gallery: Gallery) -> Picture:
    """Every method's displacement of the same replicate beside the true one; the first measured DOF."""
    drawn = list[tuple[Result, Arrays, np.ndarray, bool]]()
    for cell, arrays in with_record(gallery, gallery.scene(gallery.main, "known")):
        own = arrays.get("displacement")
        curve = simulated(cell, arrays) if own is None else own
        if curve is not None and cell.label != "prior":
            drawn.append((cell, arrays, curve, own is not None))
    if not drawn:
        raise Nothing("no reconstruction is stored")
    figure, axes = panels(len(drawn), 4, 29.0, "time (s)", sharex=True, sharey=True)
    dof = int(drawn[0][1]["sample_dof"][0])
    for axis, (cell, kept, curve, own_one) in zip(axes, drawn, strict=True):
        _panel(axis, gallery, cell, kept, curve[dof], dof, own_one)
    true = drawn[0][1]["true_displacement"][dof]
    axes[0].set_ylim(1.35 * min(true.min(), -1e-12), 1.35 * max(true.max(), 1e-12))
    figure.supylabel("displacement (m)")
    legend_below(figure, _handles())
    which = "" if len(drawn[0][1]["true_displacement"]) == 1 else f", DOF {dof + 1}"
    return Picture(
        figure,
        f"{_lead(gallery, [cell for cell, *_ in drawn])} Each panel is what a method makes of the same record "
        f"({where(drawn[0][0])}; replicate 0{which}). Solid: its own reconstruction. Dashed: it has none, and the "
        "response simulated from its parameters stands in. The number is the root mean square error of this replicate "
        "over the whole record; the first sentence names those whose error is larger than the noise of a sample. A "
        "good method's line hides the true response; one with a wrong k/m runs ahead of it or behind, more with every "
        "cycle. The paper's Figure 5 shows this for its PINN alone.",
    )


def _lead(gallery: Gallery, cells: Sequence[Result]) -> str:
    """Which reconstructions are far from the truth, in a sentence: by more than the samples' noise."""
    far = [gallery.looks[c.label].title for c in cells if c.sigma and c.first("rmse") > c.sigma[0]]
    return (
        f"All methods follow the true response except {named(far)}." if far else "All methods follow the true response."
    )


def _panel(axis: Any, gallery: Gallery, cell: Result, arrays: Arrays, curve: np.ndarray, dof: int, own: bool) -> None:
    look = gallery.looks[cell.label]
    axis.plot(arrays["dense_times"], arrays["true_displacement"][dof], **TRUE)
    axis.plot(arrays["dense_times"], curve, color=look.colour, ls="-" if own else "--", lw=1.1)
    axis.plot(*samples_of(arrays, dof), **SAMPLES)
    axis.set_title(wrapped(look.title, 38.0), loc="left")
    rmse = cell.first("rmse")
    if np.isfinite(rmse):
        text = f"RMSE {1000 * rmse:.3g} mm" if rmse < 1 else f"RMSE {rmse:.3g} m"
        axis.text(0.98, 0.97, text, transform=axis.transAxes, ha="right", va="top", fontsize=7)
    axis.grid()


def _handles() -> list[Any]:

    own = entry(color="black", lw=1.1, label="method's reconstruction")
    stand_in = entry(color="black", lw=1.1, ls="--", label="simulated from its parameters")
    return [entry(**TRUE), entry(**SAMPLES, label="samples"), own, stand_in]
