"""The misfit over k/m and c/m, and where each method ended in it: the paper's Figure 8."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.dynamics.simulate import simulate
from bench.entrants.reference import REFERENCES
from bench.reporting.figures.beside import Name, height_of, name_beside
from bench.reporting.figures.gallery import Gallery, Nothing, Picture, where
from bench.reporting.figures.style import FULL, MM, SMALL, Look, entry, legend_below, plain_logarithmic, pyplot, wrapped
from bench.reporting.frame import Result
from bench.reporting.pictures.panels import LEVEL, C, K, bound_covariance
from bench.reporting.pictures.responses import Arrays, samples_of, with_record

FAR = (8.0, 30.0)
"""How many times more and less than the truth the wide panel shows of k/m and c/m."""
NEAR = 5.0
"""Standard deviations of the bound that the narrow one shows."""
POINTS = 121
TOUCHING = 0.03
"""Estimates nearer to each other than this part of a panel's width or height share a marker, which counts them."""
LEAST, NAME = 68.0, 33.0
"""Least height of the panels and width of the names beside them (mm)."""


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


@dataclass(frozen=True, eq=False)
class BasinPanel:
    """A panel: k/m and c/m at its lower left and upper right corner, both axes logarithmic."""

    low: np.ndarray
    high: np.ndarray

    def part(self, point: np.ndarray) -> np.ndarray:
        """Where a point is, in parts of width and height."""
        return np.asarray(np.log(point / self.low) / np.log(self.high / self.low))

    def holds(self, point: np.ndarray) -> bool:
        """Whether a point is on the panel."""
        return bool(np.all((self.part(point) > 0.0) & (self.part(point) < 1.0)))

    def grid(self) -> tuple[np.ndarray, np.ndarray]:
        """Values of k/m and of c/m over the panel, (POINTS,) each."""
        k, c = np.geomspace(self.low, self.high, POINTS).T
        return k, c


def draw_basin(gallery: Gallery) -> Picture:
    """The whole basin with the other minima on the left, its floor with the 95 % region on the right."""
    cells = [c for c in gallery.main if c.kind == "sdof" and not c.forced]
    if not cells:
        raise Nothing("no record of one mass in free vibration is stored")
    found = with_record(gallery, gallery.scene(cells, "known"))
    cell, arrays = found[0]
    centre = np.array([float(cell.parameters[name]) / float(cell.parameters["m"]) for name in "kc"])
    points = {
        one.label: centre * (one.first(f"{K}_ratio"), one.first(f"{C}_ratio"))
        for one, _ in found
        if one.first(f"{K}_ratio") * one.first(f"{C}_ratio") > 0
    }
    covariance = bound_covariance(cell)
    sds = np.sqrt(np.diag(covariance)) if covariance is not None else np.array([0.02, 0.1])
    wide, floor = (BasinPanel(centre / factors, centre * factors) for factors in (np.array(FAR), 1.0 + NEAR * sds))
    on_floor = {label: floor.part(at) for label, at in points.items() if floor.holds(at)}
    beyond = {label: wide.part(at) for label, at in points.items() if label not in on_floor and wide.holds(at)}
    marked = [_marked(gallery, beyond), _marked(gallery, on_floor)]
    height = max(LEAST, *(height_of([mark.name for mark in own]) for own in marked))
    figure, axes = pyplot().subplots(
        1, 2, figsize=(FULL, (height + 26.0) * MM), layout="constrained", width_ratios=(0.42, 0.58)
    )
    for axis, window, marks in zip(axes, (wide, floor), marked, strict=True):
        surface = misfit(cell, arrays, *window.grid())
        _surface(figure, axis, window, surface, arrays["sample_values"].size if window is floor else 0)
        _estimates(axis, marks, height)
    _frame(axes[0], floor)
    axes[1].plot(*centre, marker="+", color="black", ms=10, mew=1.2, ls="none", zorder=6)
    axes[0].set_title("the whole basin", loc="left")
    axes[1].set_title("its floor: the frame on the left", loc="left")
    legend_below(figure, _handles(any(mark.look is None for own in marked for mark in own)))
    return Picture(figure, _caption(cell, len(set(on_floor) - set(REFERENCES)), len(set(points) - set(REFERENCES))))


def _caption(cell: Result, on_floor: int, total: int) -> str:
    return (
        f"{on_floor} of {total} methods end on the floor of one basin, near the truth. Misfit of the samples over the "
        f"two groups that free vibration tells ({where(cell)}; replicate 0): root mean square of the residuals, light "
        "is low. Left: away from the basin the surface is flat and rippled, and a descent from there need not end in "
        "it. Right: its floor, and as a dashed line where the likelihood's 95 % region ends. Markers: what each "
        "method found; a disc with a number stands for so many methods that found nearly the same. How far they are "
        "from each other is the methods' part of the error, how wide the region is the noise's. The paper's Figure 8 "
        "shows estimates from several initialisations and calls their closeness stability; it says nothing of their "
        "error."
    )


@dataclass(frozen=True, eq=False)
class Mark:
    """One or more methods at one place: what they are called, and the look of a single one."""

    name: Name
    count: int
    look: Look | None


def _marked(gallery: Gallery, parts: Mapping[str, np.ndarray]) -> list[Mark]:
    """The marks of methods by where they are, in parts of a panel."""
    found = []
    for labels in clusters(parts):
        looks = [gallery.looks[label] for label in labels]
        x, y = np.mean([parts[label] for label in labels], axis=0)
        text = wrapped("; ".join(look.title for look in looks), NAME)
        one = looks[0] if len(looks) == 1 else None
        found.append(Mark(Name(text, float(x), float(y), one.colour if one else "0.2"), len(looks), one))
    return found


def clusters(parts: Mapping[str, np.ndarray]) -> list[list[str]]:
    """Labels by place, each with those nearer than TOUCHING to the first of its cluster, in the order given."""
    found: list[list[str]] = []
    for label, at in parts.items():
        near = next((own for own in found if np.max(np.abs(parts[own[0]] - at)) < TOUCHING), None)
        if near is None:
            found.append([label])
        else:
            near.append(label)
    return found


def _surface(figure: Any, axis: Any, window: BasinPanel, surface: np.ndarray, region: int) -> None:
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap
    from matplotlib.ticker import MaxNLocator

    k, c = window.grid()
    greys = ListedColormap(colormaps["Greys"](np.linspace(0.0, 0.55, 256)))
    filled = axis.contourf(k, c, surface, levels=12, cmap=greys)
    axis.contour(k, c, surface, levels=filled.levels, colors="0.55", linewidths=0.4)
    bar = figure.colorbar(filled, ax=axis, location="bottom", pad=0.02, aspect=30)
    bar.set_label("root mean square misfit (m)")
    bar.locator = MaxNLocator(4)
    bar.update_ticks()
    if region:
        ratio = region * np.log(surface**2 / np.min(surface) ** 2)
        axis.contour(k, c, ratio, levels=[LEVEL], colors="black", linestyles="--", linewidths=0.9)
    axis.set(xscale="log", yscale="log", xlabel="k/m (1/s²)", ylabel="c/m (1/s)", xlim=k[[0, -1]], ylim=c[[0, -1]])
    for own in (axis.xaxis, axis.yaxis):
        plain_logarithmic(own)


def _estimates(axis: Any, marks: Sequence[Mark], height: float) -> None:
    """Markers, discs that count, and the names of both beside the panel."""
    name_beside(axis, [mark.name for mark in marks], height)
    for mark in marks:
        at = (mark.name.x, mark.name.y)
        if mark.look is not None:
            style = {**mark.look.point(5.0, hollow=True), "mew": 1.1}
            axis.plot(*at, **style, ls="none", zorder=4, transform=axis.transAxes)
            continue
        axis.plot(*at, marker="o", ms=9.0, mfc="0.2", mec="white", mew=0.6, zorder=4, transform=axis.transAxes)
        style = {"ha": "center", "va": "center_baseline", "fontsize": SMALL, "color": "white"}
        axis.text(*at, f"{mark.count}", **style, zorder=5, transform=axis.transAxes)


def _frame(axis: Any, floor: BasinPanel) -> None:
    """The right panel on the left one."""
    from matplotlib.patches import Rectangle

    left, bottom = floor.low.tolist()
    axis.add_patch(Rectangle((left, bottom), *(floor.high - floor.low), fc="none", ec="black", lw=1.0, zorder=6))


def _handles(discs: bool) -> list[Any]:
    truth = entry(ls="none", marker="+", color="black", ms=9, mew=1.2, label="truth")
    disc = entry(ls="none", marker="o", color="0.2", ms=9, label="so many methods")
    return [truth, entry(color="black", ls="--", lw=0.9, label="95 % region"), *([disc] if discs else [])]
