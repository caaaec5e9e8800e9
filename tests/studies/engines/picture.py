"""The picture of growth: processor time against replicates, samples and masses, with the exponents at the lines."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bench.reporting.figures.style import FULL, MM, SMALL, handle, legend_below, looks, pyplot, save_figure
from tests.studies.engines.results import Growth

TITLES = {
    "together": ("data sets together", "time of all (s)"),
    "samples": ("samples", "time of a fit (s)"),
    "masses": ("masses in the chain", "time of a fit (s)"),
}
NEAR = 2.5
DASHES = ("-", (0, (4, 1.5)), (0, (1, 1)), (0, (5, 1, 1, 1)))
"""Beside its marker each line has a stroke of its own, by which it is told where there is no colour."""


def lifted(growths: Sequence[Growth]) -> list[tuple[Growth, float]]:
    """The curves from the lowest end to the highest, each with points by which its number is lifted over the last.

    It is where it would stand on that of a line that ends near by: within so many times its size and its time.
    """
    found: list[tuple[Growth, float]] = []
    for growth in sorted(growths, key=lambda one: one.seconds[-1]):
        near = [
            lift
            for other, lift in found
            if growth.seconds[-1] < NEAR * other.seconds[-1]
            and max(growth.sizes[-1] / other.sizes[-1], other.sizes[-1] / growth.sizes[-1]) < NEAR
        ]
        found.append((growth, max(near) + SMALL if near else 0.0))
    return found


def picture(growths: Sequence[Growth], folder: Path) -> list[Path]:
    """Draw the curves, one panel for each kind of size."""
    figure, axes = pyplot().subplots(1, 3, figsize=(FULL, 66.0 * MM), layout="constrained")
    look = looks({growth.curve.method for growth in growths})
    strokes = dict(zip(look, (DASHES[i % len(DASHES)] for i in range(len(look))), strict=True))
    for axis, (kind, (label, title)) in zip(axes, TITLES.items(), strict=True):
        for growth in (one for one in growths if one.curve.axis == kind and one.sizes):
            method = growth.curve.method
            style = {"color": look[method].colour, "ls": strokes[method], **look[method].point(4.0)}
            axis.plot(growth.sizes, growth.seconds, **style)
        for growth, lift in lifted([one for one in growths if one.curve.axis == kind and len(one.sizes) > 1]):
            axis.annotate(
                f"{growth.exponent:.2f}", (growth.sizes[-1], growth.seconds[-1]), (5, lift),
                textcoords="offset points", fontsize=SMALL, va="center", annotation_clip=False,
            )  # fmt: skip
        axis.set(xscale="log", yscale="log", xlabel=label, title=title)
        axis.margins(x=0.16)
        axis.grid(which="major")
        axis.minorticks_off()
    sizes = sorted({size for growth in growths if growth.curve.axis == "masses" for size in growth.sizes})
    axes[2].set_xticks(sizes, [str(size) for size in sizes])
    legend_below(figure, [handle(own, ls=strokes[name]) for name, own in look.items()])
    return save_figure(figure, folder, "engines_scaling")
