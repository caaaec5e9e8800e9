"""The picture of growth: processor time against data sets, samples and masses, with the exponents at the lines."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from bench.reporting.figures.style import (
    FULL,
    MM,
    NORMAL,
    SMALL,
    handle,
    legend_below,
    looks,
    plain_logarithmic,
    pyplot,
    save_figure,
)
from tests.studies.engines.results import LARGE, Growth
from tests.studies.engines.rows import CURVES

TITLES = {
    "together": ("data sets", "time of all data sets together (s)"),
    "samples": ("samples", "time of a fit (s)"),
    "masses": ("masses", "time of a fit (s)"),
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


def stored_growths(table: pd.DataFrame) -> list[Growth]:
    """The curves of a table of numbers as ``page.tidy`` makes it, without what ended them."""
    found = []
    for curve in CURVES:
        own = table[(table.part == "growth") & (table["name"] == f"{curve.method} {curve.axis}")]
        if len(own):
            found.append(Growth(curve, tuple(own["size"].astype(int)), tuple(own.seconds.astype(float))))
    return found


def picture(growths: Sequence[Growth], folder: Path) -> list[Path]:
    """Draw the curves, one panel for each kind of size."""
    figure, axes = pyplot().subplots(1, 3, figsize=(FULL, 62.0 * MM), layout="constrained")
    look = looks({growth.curve.method for growth in growths})
    strokes = dict(zip(look, (DASHES[i % len(DASHES)] for i in range(len(look))), strict=True))
    for axis, (kind, (label, title)) in zip(axes, TITLES.items(), strict=True):
        for growth in (one for one in growths if one.curve.axis == kind and one.sizes):
            method = growth.curve.method
            style = {"color": look[method].colour, "ls": strokes[method], **look[method].point(4.0)}
            axis.plot(growth.sizes, growth.seconds, **style)
        for growth, lift in lifted([one for one in growths if one.curve.axis == kind and len(one.sizes) > 1]):
            axis.annotate(
                f"$n^{{{growth.exponent:.2f}}}$", (growth.sizes[-1], growth.seconds[-1]), (5, lift),
                textcoords="offset points", fontsize=NORMAL + 1.0, va="center", annotation_clip=False,
            )  # fmt: skip
        axis.set(xscale="log", yscale="log", xlabel=f"number n of {label} (−)")
        axis.set_title(title, loc="left")
        axis.margins(x=0.2)
        axis.grid(which="major")
        axis.minorticks_off()
        plain_logarithmic(axis.xaxis)
        plain_logarithmic(axis.yaxis)
    sizes = sorted({size for growth in growths if growth.curve.axis == "masses" for size in growth.sizes})
    axes[2].set_xticks(sizes, [str(size) for size in sizes])
    legend_below(figure, [handle(own, ls=strokes[name]) for name, own in look.items()])
    return save_figure(figure, folder, "engines_scaling", caption(growths))


def caption(growths: Sequence[Growth]) -> str:
    """Return the caption of the picture."""
    known = [growth for growth in growths if len(growth.sizes) > 1]
    steep = [growth for growth in known if growth.exponent > LARGE]
    look = looks({growth.curve.method for growth in growths})
    said = "; ".join(f"{look[g.curve.method].title} with {TITLES[g.curve.axis][0]}" for g in steep) or "none"
    return (
        f"Time grows faster than the problem on {len(steep)} of {len(known)} lines. Processor time against the number "
        "of data sets solved together, of samples and of masses; left the time of all data sets together, else that "
        "of a fit. At the end of each line is the power of the number n with which its upper half grows; above "
        f"{LARGE:g} it counts as faster: {said}."
    )
