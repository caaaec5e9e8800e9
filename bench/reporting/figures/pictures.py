"""All pictures by name: those of the paper's Figures 4 to 11 in order, then ours."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from bench.reporting.figures.band import draw_band
from bench.reporting.figures.basin import draw_basin
from bench.reporting.figures.coverage import draw_coverage
from bench.reporting.figures.failures import draw_failures
from bench.reporting.figures.family import draw_family
from bench.reporting.figures.forest import draw_forest
from bench.reporting.figures.gallery import Gallery, Picture
from bench.reporting.figures.noise import draw_displacement, draw_noise
from bench.reporting.figures.profiles import draw_profiles
from bench.reporting.figures.response import draw_reconstruction, draw_record
from bench.reporting.figures.scatter import draw_scatter
from bench.reporting.figures.style import save_figure
from bench.reporting.figures.time import draw_time
from bench.reporting.figures.training import draw_training
from bench.reporting.figures.two_masses import draw_two_masses
from bench.reporting.figures.waterfall import draw_waterfall

PICTURES: dict[str, Callable[[Gallery], Picture]] = {
    "record": draw_record,
    "reconstruction": draw_reconstruction,
    "training_loss": draw_training,
    "scatter": draw_scatter,
    "basin": draw_basin,
    "band": draw_band,
    "error_against_noise": draw_noise,
    "displacement_against_noise": draw_displacement,
    "two_masses": draw_two_masses,
    "forest": draw_forest,
    "coverage": draw_coverage,
    "accuracy_against_time": draw_time,
    "profiles": draw_profiles,
    "failures": draw_failures,
    "family": draw_family,
    "waterfall": draw_waterfall,
}
"""By file name, what draws it."""


def write_picture(gallery: Gallery, name: str, out: Path, svg: Path | None = None) -> list[Path]:
    """Draw a picture and write its files; returns their paths. Raises Nothing where there is nothing to draw."""
    picture = PICTURES[name](gallery)
    changed = _changed_names(gallery, picture.figure)
    return save_figure(picture.figure, out, picture.name or name, picture.caption + changed, svg)


def _changed_names(gallery: Gallery, figure: Any) -> str:
    """What stands for names in a figure that could not be drawn as they are."""
    from matplotlib.text import Text

    shown = "\n".join(text.get_text().replace("\n", " ") for text in figure.findobj(Text))
    changed = [look for look in gallery.looks.values() if "\\u" in look.title or "…" in look.title]
    return "".join(f" {look.title} stands for {look.label}." for look in changed if look.title in shown)
