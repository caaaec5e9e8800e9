"""All pictures of a store by name: the first one, those of the paper's Figures 4 to 11 in order, then ours."""

from __future__ import annotations

from collections.abc import Callable

from bench.reporting.pictures.curves import draw_noise, draw_training
from bench.reporting.pictures.gallery import Gallery
from bench.reporting.pictures.hero import draw_hero
from bench.reporting.pictures.maps import draw_basin, draw_failures, draw_scatter
from bench.reporting.pictures.responses import draw_band, draw_reconstruction, draw_record, draw_two_masses
from bench.reporting.pictures.rows import draw_coverage, draw_family, draw_forest, draw_time
from bench.reporting.pictures.style import Picture

PICTURES: dict[str, Callable[[Gallery], Picture]] = {
    "hero": draw_hero,
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
    "failures": draw_failures,
    "family": draw_family,
}
