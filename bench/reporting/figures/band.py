"""The band that a method puts around its displacement, and how much of the truth is in it: the paper's Figure 9."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from bench.reporting.figures.gallery import Gallery, Nothing, Picture, counts, where
from bench.reporting.figures.response import with_record
from bench.reporting.figures.style import panels, wrapped
from bench.reporting.frame import Result
from bench.scoring.statistics import Z95


def draw_band(gallery: Gallery) -> Picture:
    """The error of each reconstruction with its band: where the band holds zero, it holds the truth."""
    found = with_record(gallery, gallery.scene(gallery.main, "known"))
    found = [(cell, a) for cell, a in found if "displacement_sd" in a and "displacement" in a]
    if not found:
        raise Nothing("no band is stored")
    figure, axes = panels(len(found), 3, 46.0, "time (s)", sharex=True)
    for axis, (cell, arrays) in zip(axes, found, strict=True):
        look, times = gallery.looks[cell.label], arrays["dense_times"]
        dof = int(arrays["sample_dof"][0])
        error = 1000.0 * (arrays["displacement"][dof] - arrays["true_displacement"][dof])
        half = 1000.0 * Z95 * arrays["displacement_sd"][dof]
        axis.fill_between(times, error - half, error + half, color=look.colour, alpha=0.3, lw=0)
        axis.plot(times, error, color=look.colour, lw=1.0)
        axis.axhline(0.0, color="black", lw=0.8)
        inside = cell.successful("band_inside_95")
        share = f"\n{100 * inside.mean():.0f} % inside (n = {inside.size})" if inside.size else ""
        axis.set_title(f"{wrapped(look.title, 44.0)}{share}", loc="left")
        axis.set_ylabel("estimate − truth (mm)")
        reach = 1.1 * float(np.max(np.abs(error) + half))
        axis.set_ylim(-reach, reach) if math.isfinite(reach) and reach > 0 else None
        axis.grid()
    cells = [cell for cell, _ in found]
    return Picture(
        figure,
        f"{_lead(cells)} Each panel is a method that states a band ({where(cells[0])}; replicate 0): its "
        "reconstruction minus the true response, and 1.96 of its standard deviations to either side. Where the band "
        "holds the line at zero it holds "
        f"the truth. The percentage is measured: the mean share of the record inside the method's own 95 % band over "
        f"{counts(cells)} replicates; 95 is what a band should have. Scales differ from panel to panel. The bands "
        "breathe with the motion: parameters that are a little wrong move the response most where it is fast or far "
        "out. The paper's Figure 9 draws such a band without saying how often it holds.",
    )


def _lead(cells: Sequence[Result]) -> str:
    """How often the bands hold the truth, in a sentence."""
    shares = [100.0 * float(own.mean()) for cell in cells if (own := cell.successful("band_inside_95")).size]
    if not shares:
        return "A band says how far a reconstruction may be off."
    low, high = f"{min(shares):.0f}", f"{max(shares):.0f}"
    return f"95 % bands hold the truth over {low if low == high else f'{low} to {high}'} % of the record."
