"""Whether stated intervals hold the truth as often as they say, at every level."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from scipy.stats import binom

from bench.reporting.figures.gallery import Gallery, Nothing, Picture, counts, where
from bench.reporting.figures.style import entry, legend_below, panels, wrapped
from bench.reporting.frame import Result
from bench.reporting.tables.calibration import FEWEST

NOMINAL = np.linspace(0.01, 0.99, 99)
QUANTITIES = (("k_over_m", "k/m", "-"), ("c_over_m", "c/m", (0, (3.5, 1.2))))
BAND_LEVELS = (50, 80, 95)


def covered(levels: np.ndarray, nominal: np.ndarray) -> np.ndarray:
    """Share of replicates whose equal-tailed interval of each nominal level holds the truth, shape of ``nominal``.

    ``levels`` (n,) are the belief's levels at the truth: an interval of level v holds it where they are within v/2 of
    a half.
    """
    return np.asarray(np.mean(np.abs(levels - 0.5)[:, None] <= nominal / 2.0 + 1e-12, axis=0))


def _most_replicates(gallery: Gallery) -> list[Result]:
    """The main scenario under the seed with most levels: calibration is tested on one of its own."""

    def alike(cell: Result) -> str:
        return json.dumps({**json.loads(cell.series), "seed": 0}, sort_keys=True)

    wanted = alike(gallery.main[0])
    by_seed: dict[int, list[Result]] = {}
    for cell in gallery.cells:
        if alike(cell) == wanted:
            by_seed.setdefault(cell.seed, []).append(cell)
    scenes = {seed: gallery.scene(own, "unknown") for seed, own in by_seed.items()}
    return max(scenes.values(), key=lambda own: (sum(c.successful("k_over_m_pit").size for c in own), -own[0].seed))


def draw_coverage(gallery: Gallery) -> Picture:
    """One panel a method: measured against nominal level of the intervals of k/m, c/m and the displacement's band."""
    cells = [c for c in _most_replicates(gallery) if c.label != "prior"]
    stated = {c.label for c in cells if c.successful("k_over_m_pit").size >= FEWEST}
    cells = [c for c in cells if c.label in stated]
    if not cells:
        raise Nothing(f"no method with intervals of k/m over {FEWEST} replicates or more is stored")
    figure, axes = panels(len(cells), 5, 34.0, "nominal level (%)", sharex=True, sharey=True)
    for axis, cell in zip(axes, cells, strict=True):
        _panel(axis, gallery, cell)
    axes[0].set(xlim=(-4, 104), ylim=(-4, 104))
    axes[0].set_xticks([0, 50, 95], ["0", "50", "95"])
    axes[0].set_yticks([0, 50, 95], ["0", "50", "95"])
    figure.supylabel("replicates whose interval holds the truth (%)")
    legend_below(figure, _handles(any(_band(cell) for cell in cells)))
    band = " Squares: mean share of the record inside the displacement's band." if any(map(_band, cells)) else ""
    held = [_holds(cell) for cell in cells if not cell.is_reference]
    return Picture(
        figure,
        f"The 95 % intervals of k/m hold the truth as often as they say in {sum(held)} of {len(held)} methods. For "
        f"each level, how often the interval of k/m and of c/m held the truth ({where(cells[0])}, seed "
        f"{cells[0].seed}; {counts(cells)} replicates).{band} On the diagonal a statement is right; below it a method "
        "is too sure of itself, above it too modest. In the grey band a calibrated method is with 95 % probability at "
        "each level, given so many replicates; over all levels it may leave the band here and there by chance. The "
        "tables say in numbers which methods are not calibrated.",
    )


def _holds(cell: Result) -> bool:
    """Whether the 95 % interval of k/m held the truth as often as that of a calibrated method, up to chance."""
    levels = cell.successful("k_over_m_pit")
    low, high = binom.ppf([0.025, 0.975], levels.size, 0.95) / levels.size
    return bool(low <= covered(levels, np.array([0.95]))[0] <= high)


def _band(cell: Result) -> list[tuple[int, float]]:
    found = [(level, cell.successful(f"band_inside_{level}")) for level in BAND_LEVELS]
    return [(level, float(own.mean())) for level, own in found if own.size]


def _panel(axis: Any, gallery: Gallery, cell: Result) -> None:
    look, n = gallery.looks[cell.label], cell.successful("k_over_m_pit").size
    low, high = (100.0 * binom.ppf(tail, n, NOMINAL) / n for tail in (0.025, 0.975))
    axis.fill_between(100.0 * NOMINAL, low, high, color="0.88", lw=0)
    axis.plot([0, 100], [0, 100], color="0.6", lw=0.6)
    for name, _, dashes in QUANTITIES:
        levels = cell.successful(f"{name}_pit")
        if levels.size:
            axis.plot(100.0 * NOMINAL, 100.0 * covered(levels, NOMINAL), color=look.colour, ls=dashes, lw=1.1)
    for level, share in _band(cell):
        axis.plot(level, 100.0 * share, marker="s", ms=3.2, mfc="white", mec=look.colour, mew=0.8, ls="none")
    axis.set_title(wrapped(look.title, 28.0), loc="left")
    axis.text(1, 100, f"n = {n}", va="top", fontsize=7)
    axis.set_aspect("equal")
    axis.grid()


def _handles(bands: bool) -> list[Any]:
    from matplotlib.patches import Patch

    own = [entry(color="0.2", ls=dashes, lw=1.1, label=name) for _, name, dashes in QUANTITIES]
    square = entry(ls="none", marker="s", ms=3.2, mfc="white", mec="0.2", mew=0.8, label="displacement's band")
    return [*own, *([square] if bands else []), Patch(fc="0.88", ec="none", label="95 % range if calibrated")]
