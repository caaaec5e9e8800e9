"""k/m and c/m of all replicates, with the ellipse that the data allow: the paper's Figure 7."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.reporting.figures.gallery import Gallery, Nothing, Picture, counts, named, where
from bench.reporting.figures.style import entry, legend_below, panels, wrapped
from bench.reporting.frame import Result

LEVEL = 5.991
"""The 95 % quantile of chi-squared with two degrees of freedom."""
REACH = 4.5
"""Half the width of a panel, in standard deviations of the bound."""
BESIDE = 1.5
"""A cloud is beside the truth whose median k/m is off by so many median deviations from it."""
K, C = "k_over_m", "c_over_m"


def bound_covariance(cell: Result) -> np.ndarray | None:
    """The bound on the covariance of (log k/m, log c/m), (2, 2); None where the cell's bounds do not tell it.

    All is in the stored bounds: with ``ζ = (c/m) / 2 (k/m)^(1/2)``, ``var log ζ = var log c/m + var log k/m / 4 -
    cov(log k/m, log c/m)``.
    """
    k, c, zeta = (cell.bound(f"{name}_error_pct") / 100.0 for name in (K, C, "damping_ratio"))
    if not all(map(math.isfinite, (k, c, zeta))):
        return None
    cross = c**2 + k**2 / 4.0 - zeta**2
    return np.array([[k**2, cross], [cross, c**2]])


def ellipse(covariance: np.ndarray) -> np.ndarray:
    """Errors (%) on the 95 % ellipse of a normal pair of logarithms around no error, shape (2, n)."""
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    circle = np.sqrt(LEVEL) * np.stack([np.cos(angle), np.sin(angle)])
    return np.asarray(100.0 * np.expm1(np.linalg.cholesky(covariance + 1e-18 * np.eye(2)) @ circle))


def draw_scatter(gallery: Gallery) -> Picture:
    """One panel a method: every replicate's errors of both groups, and the bound's 95 % ellipse."""
    cells = [c for c in gallery.scene(gallery.main, "known") if c.label != "prior"]
    cells = [c for c in cells if c.successful(f"{K}_ratio").size and c.successful(f"{C}_ratio").size]
    if not cells:
        raise Nothing("no estimates of k/m and c/m are stored")
    covariance = bound_covariance(cells[0])
    limits = _limits(cells, covariance)
    figure, axes = panels(len(cells), 5, 33.0, "error of k/m (%)", sharex=True, sharey=True)
    for axis, cell in zip(axes, cells, strict=True):
        _panel(axis, gallery, cell, covariance, limits)
    axes[0].set(xlim=(-limits[0], limits[0]), ylim=(-limits[1], limits[1]))
    figure.supylabel("error of c/m (%)")
    legend_below(figure, _handles(covariance is not None))
    region = (
        "The ellipse is the Cramér-Rao bound's: 95 % of the estimates of an unbiased method that reaches it lie in it "
        "(its correlation follows from the stored bounds of k/m, c/m and damping ratio). "
        if covariance is not None
        else ""
    )
    return Picture(
        figure,
        f"{_lead(gallery, cells)} One point is a replicate: its errors of both identifiable groups "
        f"({where(cells[0])}; {counts(cells)} a method). {region}The cross is the truth. Estimates beyond a panel's "
        "edge stand on it as small triangles, and are counted. Methods on the bound fill the ellipse and nothing "
        "else; a cloud beside it is a bias, a wider one is information lost. Beside the truth counts a cloud whose "
        f"median k/m is off by more than {BESIDE:g} median deviations. The paper's Figure 7 shows one estimate of "
        "each group.",
    )


def _lead(gallery: Gallery, cells: Sequence[Result]) -> str:
    """Which clouds lie beside the truth, in a sentence: those whose middle k/m is off by more than its own spread."""
    beside = []
    for cell in cells:
        k = cell.successful(f"{K}_ratio") - 1.0
        middle = float(np.median(k))
        if abs(middle) > BESIDE * float(np.median(np.abs(k - middle))):
            beside.append(gallery.looks[cell.label].title)
    if not beside:
        return "All methods scatter around the truth."
    return f"All methods scatter around the truth except {named(beside)}."


def _limits(cells: list[Result], covariance: np.ndarray | None) -> np.ndarray:
    if covariance is not None:
        return 100.0 * REACH * np.sqrt(np.diag(covariance))
    spreads = [[np.median(np.abs(c.successful(f"{n}_ratio") - 1.0)) for n in (K, C)] for c in cells]
    return np.asarray(100.0 * 5.0 * np.maximum(np.median(spreads, axis=0), 1e-6))


def _panel(axis: Any, gallery: Gallery, cell: Result, covariance: np.ndarray | None, limits: np.ndarray) -> None:
    look = gallery.looks[cell.label]
    k, c = (100.0 * (cell.scores(f"{name}_ratio") - 1.0) for name in (K, C))
    good = np.isfinite(k) & np.isfinite(c)
    errors = np.stack([k[good], c[good]])
    clipped = np.clip(errors, -limits[:, None], limits[:, None])
    outside = np.any(clipped != errors, axis=0)
    if covariance is not None:
        axis.fill(*ellipse(covariance), fc="0.92", ec="0.45", lw=0.8, zorder=1)
    small = 2.8 if look.marker not in ("s", "D", "P", "X", "h", "H") else 2.3
    axis.plot(*clipped[:, ~outside], **{**look.point(small), "mew": 0.4}, ls="none", alpha=0.8, zorder=2)
    for x, y, turn in _edges(clipped[:, outside], limits):
        style = {"mfc": look.colour, "mec": look.colour, "mew": 0.2, "linestyle": "none", "clip_on": False, "zorder": 3}
        axis.plot(x, y, marker=(3, 0, turn), ms=3.4, **style)
    axis.plot(0.0, 0.0, marker="+", color="black", ms=7, mew=0.9, zorder=4)
    axis.set_title(wrapped(look.title, 31.0), loc="left")
    if outside.any():
        box = {"fc": "white", "ec": "none", "pad": 0.8, "alpha": 0.85}
        text = f"{outside.sum()} outside"
        axis.text(0.97, 0.05, text, transform=axis.transAxes, ha="right", fontsize=7, bbox=box, zorder=5)
    axis.grid()


def _edges(points: np.ndarray, limits: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """Points on the edge (2, n), sorted by the side on which they are: x, y, and the turn of a triangle (degrees)."""
    x, y = points
    right, left = x >= limits[0], x <= -limits[0]
    top, low = (y >= limits[1]) & ~right & ~left, (y <= -limits[1]) & ~right & ~left
    sides = ((right, 270.0), (left, 90.0), (top, 0.0), (low, 180.0))
    return [(x[side], y[side], turn) for side, turn in sides if side.any()]


def _handles(bounded: bool) -> list[Any]:
    from matplotlib.patches import Patch

    region = [Patch(fc="0.92", ec="0.45", lw=0.8, label="95 % at the Cramér-Rao bound")] if bounded else []
    truth = entry(ls="none", marker="+", color="black", ms=7, mew=0.9, label="truth")
    beyond = entry(ls="none", marker=(3, 0, 270.0), color="0.3", ms=3.4, label="beyond the edge")
    return [*region, truth, beyond]
