"""All pictures by name: those of the paper's Figures 4 to 11 in order, then ours."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from bench.reporting.figures.band import draw_band
from bench.reporting.figures.basin import draw_basin
from bench.reporting.figures.coverage import draw_coverage
from bench.reporting.figures.failures import draw_failures
from bench.reporting.figures.family import draw_family
from bench.reporting.figures.forest import draw_forest
from bench.reporting.figures.gallery import Gallery, Picture
from bench.reporting.figures.noise import draw_noise
from bench.reporting.figures.profiles import draw_profiles
from bench.reporting.figures.response import draw_reconstruction, draw_record
from bench.reporting.figures.scatter import draw_scatter
from bench.reporting.figures.style import pyplot, save_figure
from bench.reporting.figures.time import draw_time
from bench.reporting.figures.training import draw_training
from bench.reporting.figures.two_masses import draw_two_masses
from bench.reporting.figures.waterfall import draw_waterfall
from bench.reporting.whole_file import write

PICTURES: dict[str, Callable[[Gallery], Picture]] = {
    "record": draw_record,
    "reconstruction": draw_reconstruction,
    "training_loss": draw_training,
    "scatter": draw_scatter,
    "basin": draw_basin,
    "band": draw_band,
    "error_against_noise": draw_noise,
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


def write_picture(gallery: Gallery, name: str, out: Path) -> list[Path]:
    """Draw a picture and write its files; the paths of the drawings. Raises Nothing where there is nothing to draw."""
    picture = PICTURES[name](gallery)
    own = picture.name or name
    paths = save_figure(picture.figure, out, own)
    write(out / f"{own}.txt", picture.caption + _changed_names(gallery) + "\n", out)
    pyplot().close(picture.figure)
    return paths


def _changed_names(gallery: Gallery) -> str:
    """What stands for names that could not be drawn as they are."""
    changed = [look for look in gallery.looks.values() if "\\u" in look.title or "…" in look.title]
    return "".join(f" {look.title} stands for {look.label}." for look in changed)
