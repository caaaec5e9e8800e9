"""The misfit over k/m and c/m, and where each method ended in it: the paper's Figure 8."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.dynamics.simulate import simulate
from bench.reporting.figures.gallery import Gallery, Nothing, Picture, where
from bench.reporting.figures.response import Arrays, samples_of, with_record
from bench.reporting.figures.scatter import LEVEL, C, K, bound_covariance
from bench.reporting.figures.style import FULL, MM, Look, entry, handle, legend_below, plain_logarithmic, pyplot
from bench.reporting.frame import Result

FAR = (8.0, 30.0)
"""How many times more and less than the truth the wide panel shows of k/m and c/m."""
NEAR = 5.0
"""Standard deviations of the bound that the narrow one shows."""
POINTS = 121


def misfit(cell: Result, arrays: Arrays, k: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Root mean square (m) of the samples' residuals over k/m (nk,) and c/m (nc,), shape (nc, nk).

    From the start that was told, else from the best one for each pair: the response is linear in it.
    """
    times, values = samples_of(arrays, 0)
    p = {"m": np.ones((c.size, k.size)), "k": np.tile(k, (c.size, 1)), "c": np.tile(c[:, None], (1, k.size))}
    system, start = cell.model, cell.start_told

    def response(x0: float, v0: float) -> np.ndarray:
        state = (np.full((1, c.size, k.size), x0), np.full((1, c.size, k.size), v0))
        return np.asarray(simulate(system, p, state, times).displacement[0])

    if start is not None:
        residual = response(float(start.displacement[0]), float(start.velocity[0])) - values
    else:
        basis = np.stack([response(1.0, 0.0), response(0.0, 1.0)], axis=-1)
        residual = (basis @ (np.linalg.pinv(basis) @ values[:, None]))[..., 0] - values
    return np.asarray(np.sqrt(np.mean(residual**2, axis=-1)))


def draw_basin(gallery: Gallery) -> Picture:
    """The whole basin with the other minima on the left, its floor with the 95 % region on the right."""
    cells = [c for c in gallery.main if c.kind == "sdof" and not c.forced]
    if not cells:
        raise Nothing("no record of one mass in free vibration is stored")
    found = with_record(gallery, gallery.scene(cells, "known"))
    cell, arrays = found[0]
    true = {name: float(value) for name, value in cell.parameters.items()}
    centre = np.array([true["k"] / true["m"], true["c"] / true["m"]])
    points = {
        one.label: centre * (one.first(f"{K}_ratio"), one.first(f"{C}_ratio"))
        for one, _ in found
        if np.isfinite(one.first(f"{K}_ratio") * one.first(f"{C}_ratio"))
    }
    figure, axes = pyplot().subplots(1, 2, figsize=(FULL, 72.0 * MM), layout="constrained")
    covariance = bound_covariance(cell)
    sds = np.sqrt(np.diag(covariance)) if covariance is not None else np.array([0.02, 0.1])
    looks = [gallery.looks[label] for label in points]
    for axis, factors in zip(axes, (np.array(FAR), 1.0 + NEAR * sds), strict=True):
        k, c = (centre[i] * np.geomspace(1.0 / factors[i], factors[i], POINTS) for i in (0, 1))
        surface = misfit(cell, arrays, k, c)
        _surface(figure, axis, k, c, surface, arrays["sample_values"].size if axis is axes[1] else 0)
        _estimates(axis, looks, points, centre)
        axis.set(xlabel="k/m (1/s²)", ylabel="c/m (1/s)", xlim=k[[0, -1]], ylim=c[[0, -1]])
    axes[0].set(xscale="log", yscale="log")
    for own in (axes[0].xaxis, axes[0].yaxis):
        plain_logarithmic(own)
    axes[0].set_title("the whole basin", loc="left")
    axes[1].set_title("its floor", loc="left")
    legend_below(figure, [*_marks(), *(_entry(look) for look in looks)])
    return Picture(
        figure,
        f"Misfit of the samples over the two groups that free vibration tells ({where(cell)}; replicate 0): root mean "
        "square of the residuals, light is low. Left: away from the basin the surface is flat and rippled, and a "
        "descent from there need not end in it. Right: the floor of the basin, and as a dashed line where the "
        "likelihood's 95 % region ends. Markers: what each method found; those beyond a panel are not in it. How "
        "far they are from each other is the methods' part of the error, how wide the region is the noise's. The "
        "paper's Figure 8 shows estimates from several initialisations and calls their closeness stability; it says "
        "nothing of their error.",
    )


def _surface(figure: Any, axis: Any, k: np.ndarray, c: np.ndarray, surface: np.ndarray, region: int) -> None:
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    greys = ListedColormap(colormaps["Greys"](np.linspace(0.0, 0.55, 256)))
    filled = axis.contourf(k, c, surface, levels=12, cmap=greys)
    axis.contour(k, c, surface, levels=filled.levels, colors="0.55", linewidths=0.4)
    bar = figure.colorbar(filled, ax=axis, pad=0.01, aspect=30)
    bar.set_label("root mean square misfit (m)")
    bar.locator = _few()
    bar.update_ticks()
    if region:
        ratio = region * np.log(surface**2 / np.min(surface) ** 2)
        axis.contour(k, c, ratio, levels=[LEVEL], colors="black", linestyles="--", linewidths=0.9)


def _few() -> Any:
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(5)


def _estimates(axis: Any, looks: list[Look], points: dict[str, np.ndarray], centre: np.ndarray) -> None:
    for i, look in enumerate(looks):
        style = {**look.point(4.0 + 4.0 * (len(looks) - i) / len(looks), hollow=True), "mew": 1.1}
        axis.plot(*points[look.label], **style, ls="none", zorder=4 + i)
    axis.plot(*centre, marker="+", color="black", ms=10, mew=1.2, ls="none", zorder=3)


def _entry(look: Look) -> Any:
    return handle(look, **{**look.point(5.0, hollow=True), "mew": 1.1, "lw": 0.0})


def _marks() -> list[Any]:

    truth = entry(ls="none", marker="+", color="black", ms=9, mew=1.2, label="truth")
    return [truth, entry(color="black", ls="--", lw=0.9, label="95 % region")]
