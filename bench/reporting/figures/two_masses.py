"""A system of several masses, identified: the paper's Figure 11, which there is a simulation alone."""

from __future__ import annotations

import numpy as np

from bench.dynamics.simulate import simulate
from bench.reporting.figures.gallery import Gallery, Nothing, Picture, methods_only, where
from bench.reporting.figures.response import (
    SAMPLES,
    TRUE,
    Arrays,
    point_parameters,
    samples_of,
    with_record,
)
from bench.reporting.figures.style import FULL, MM, legend_below, pyplot
from bench.reporting.frame import Result
from bench.reporting.labels import beside_paper, title
from bench.reporting.paper import own_method
from bench.scoring.statistics import Z95

DRAWS = 400
MOST = 5
"""DOFs shown at most."""


def draw_two_masses(gallery: Gallery) -> Picture:
    """Response of every DOF, identified and true, and beside it the error with its band."""
    cells = gallery.largest(one for one in gallery.cells if one.n_dof > 1)
    own = methods_only(gallery.scene(cells, "known"))
    found = [(cell, a) for cell, a in with_record(gallery, own) if "displacement" in a]
    if not found:
        raise Nothing("no reconstruction of a system of two masses or more is stored")
    first = beside_paper(own_method())  # the paper's own, else the first of all
    cell, arrays = next((pair for label in first for pair in found if pair[0].label == label), found[0])
    sd, source = band(cell, arrays)
    n = min(len(arrays["true_displacement"]), MOST)
    figure, axes = pyplot().subplots(
        n, 2, figsize=(FULL, (10.0 + 32.0 * n) * MM), layout="constrained", squeeze=False, sharex=True
    )
    look, times = gallery.looks[cell.label], arrays["dense_times"]
    for dof, (left, right) in enumerate(axes):
        line = {"color": look.colour, "lw": 1.1, "label": f"identified by {look.title}"}
        true, curve = arrays["true_displacement"][dof], arrays["displacement"][dof]
        left.plot(times, true, **TRUE)
        left.plot(times, curve, **line)
        left.plot(*samples_of(arrays, dof), **SAMPLES, label="samples")
        left.set_ylabel(f"$x_{{{dof + 1}}}$ (m)")
        right.plot(times, 1000.0 * (curve - true), **line)
        if sd is not None:
            low, high = (1000.0 * (curve - true + sign * Z95 * sd[dof]) for sign in (-1.0, 1.0))
            right.fill_between(times, low, high, color=look.colour, alpha=0.3, lw=0, label="its 95 % band")
        right.axhline(0.0, color="black", lw=0.8)
        right.set_ylabel(f"error of $x_{{{dof + 1}}}$ (mm)")
        for axis in (left, right):
            axis.grid()
    for axis in axes[-1]:
        axis.set_xlabel("time (s)")
    handles = {label: h for axis in axes[0] for h, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    legend_below(figure, list(handles.values()))
    return Picture(figure, _caption(cell, arrays, sd, source, n))


def _caption(cell: Result, arrays: Arrays, sd: np.ndarray | None, source: str, n: int) -> str:
    off, inside = np.abs(arrays["displacement"] - arrays["true_displacement"]), ""
    off_mm = 1000.0 * float(np.sqrt(np.mean(off**2)))
    if sd is not None:
        share = 100 * np.mean(off[:n] <= Z95 * sd[:n])
        inside = f" In this replicate it holds {share:.0f} % of the true responses."
    return (
        f"{title(cell.label)} finds the motion of {len(off)} masses to {off_mm:.2g} mm, root mean square. Left: "
        f"response, with the samples shown ({where(cell)}; replicate 0). Right: estimate minus truth, in "
        f"millimetres.{source}{inside} Where the band holds the line at zero it holds the truth. The paper's Figure "
        "11 shows a simulated response of two masses, of which nothing is identified."
    )


def band(cell: Result, arrays: Arrays) -> tuple[np.ndarray | None, str]:
    """Standard deviation (n_dof, n_dense) of the displacement, and in words where it is from.

    The method's own, or the spread of responses to draws of its stated normal belief or to its own draws, where the
    start was told and no force acts.
    """
    if "displacement_sd" in arrays:
        return arrays["displacement_sd"], " The band is the method's own, 1.96 standard deviations to either side."
    draws = belief_draws(cell, arrays)
    start = cell.start_told
    if draws is None or start is None or cell.forced:
        return None, " The method states no band."
    system = cell.model
    p = dict(zip(system.names, draws.T, strict=True))
    spread = (np.repeat(part[:, None], len(draws), 1) for part in (start.displacement, start.velocity))
    x0, v0 = spread
    paths = simulate(system, p, (x0, v0), arrays["dense_times"]).displacement
    return np.nanstd(paths, axis=1), " The band is the spread of the responses to the method's stated parameters."


def belief_draws(cell: Result, arrays: Arrays) -> np.ndarray | None:
    """Draws (n, n_parameters) of a stored belief over all parameters in the system's order; None where it is another.

    A stored mean does not say whether it is of logarithms, nor in which order: it is taken if it gives the parameters
    that were scored.
    """
    p = point_parameters(cell)
    if p is None:
        return None
    values = np.array([p[name] for name in cell.model.names])
    if "draws" in arrays:
        own = arrays["draws"]
        close = own.shape[1] == values.size and np.all(np.abs(np.log(np.median(own, 0) / values)) < 0.5)
        return own if close else None
    if "covariance" not in arrays or arrays["mean"].shape != values.shape:
        return None
    if not np.allclose(np.exp(arrays["mean"]), values, rtol=1e-3):
        return None
    normal = np.random.default_rng(0).multivariate_normal(arrays["mean"], arrays["covariance"], DRAWS, method="svd")
    return np.exp(normal)
