"""All pictures by name: those of the paper's Figures 4 to 11 in order, then ours."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from bench.reporting.figures.basin import draw_basin
from bench.reporting.figures.gallery import Gallery, Picture
from bench.reporting.figures.style import save_figure
from bench.reporting.pictures.family import draw_family
from bench.reporting.pictures.maps import draw_failures
from bench.reporting.pictures.panels import draw_coverage, draw_noise, draw_scatter
from bench.reporting.pictures.responses import (
    draw_band,
    draw_reconstruction,
    draw_record,
    draw_training,
    draw_two_masses,
)
from bench.reporting.pictures.rows import draw_forest, draw_profiles, draw_time
from bench.reporting.pictures.style import FULL, HALF, save_chart, specification

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
}
"""By file name, what draws it."""


def write_picture(gallery: Gallery, name: str, out: Path, svg: Path | None = None) -> list[Path]:
    """Draw a picture and write its files; returns their paths. Raises Nothing where there is nothing to draw."""
    picture = PICTURES[name](gallery)
    name = picture.name or name
    if hasattr(picture.figure, "findobj"):
        from matplotlib.text import Text

        texts = [text.get_text() for text in picture.figure.findobj(Text)]
        caption = picture.caption + _changed_names(gallery, texts)
        return save_figure(picture.figure, out, name, caption, svg)
    spec = specification(picture.figure, HALF if picture.half else FULL)
    texts = [str(value) for rows in spec["datasets"].values() for row in rows for value in row.values()]
    return save_chart(spec, out, name, picture.caption + _changed_names(gallery, texts), svg)


def _changed_names(gallery: Gallery, texts: Iterable[str]) -> str:
    """What stands for names among the texts of a picture that could not be drawn as they are."""
    shown = " ".join(dict.fromkeys(text.replace("\n", " ") for text in texts))
    changed = [look for look in gallery.looks.values() if "\\u" in look.title or "…" in look.title]
    return "".join(f" {look.title} stands for {look.label}." for look in changed if look.title in shown)
