"""``python -m bench.figures``: the pictures of a store, from its rows and arrays alone, as SVG and PNG with a caption.

A picture for which the store has nothing is left out, and one line says why.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from bench.commands.guard import command, read_folders
from bench.errors import InputError
from bench.reporting.figures.band import draw_band
from bench.reporting.figures.basin import draw_basin
from bench.reporting.figures.coverage import draw_coverage
from bench.reporting.figures.failures import draw_failures
from bench.reporting.figures.forest import draw_forest
from bench.reporting.figures.gallery import Gallery, Nothing, Picture
from bench.reporting.figures.noise import draw_noise
from bench.reporting.figures.profiles import draw_profiles
from bench.reporting.figures.response import draw_reconstruction, draw_record
from bench.reporting.figures.scatter import draw_scatter
from bench.reporting.figures.style import pyplot, save_figure
from bench.reporting.figures.time import draw_time
from bench.reporting.figures.training import draw_training
from bench.reporting.figures.two_masses import draw_two_masses
from bench.store.store import Store

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
}
"""By file name, what draws it; first the paper's Figures 4 to 11 in order, then ours."""


def main(argv: Sequence[str] | None = None) -> int:
    """``python -m bench.figures [store=results/rows] [out=results/figures]``; exit status 2 for bad input."""
    usage = "usage: python -m bench.figures [store=results/rows] [out=results/figures]"
    return command("bench.figures", f"{usage}\n\n{__doc__}", argv, _main)


def _main(arguments: Sequence[str]) -> int:
    try:
        folders = read_folders(arguments, {"store": "results/rows", "out": "results/figures"})
        gallery = read(folders["store"])
        Store(folders["out"]).prepare()
        drawn = sum(write(gallery, name, folders["out"]) for name in PICTURES)
        if not drawn:
            raise InputError("store", folders["store"], "no cell there has what a picture needs; run experiment=table5")
    except ImportError as error:
        if "matplotlib" not in str(error):
            raise
        print("bench.reporting.figures: matplotlib is missing: pip install 'vibration-bench[figures]'", file=sys.stderr)
        return 2
    return 0


def read(folder: Path) -> Gallery:
    """The cells of a store; raises InputError where there is none."""
    store = Store(folder)
    if not folder.is_dir() or not store.identities():
        raise InputError("store", folder, "no cell there; run python -m bench -m experiment=table5 first")
    return Gallery(store)


def write(gallery: Gallery, name: str, out: Path) -> bool:
    """Draw one picture and write its files, saying so; whether there was something to draw."""
    try:
        picture = PICTURES[name](gallery)
    except Nothing as reason:
        print(f"bench.reporting.figures: {name}: not drawn: {reason}", file=sys.stderr)
        return False
    for path in save_figure(picture.figure, out, name):
        print(path)
    (out / f"{name}.txt").write_text(picture.caption + names_of(gallery) + "\n", encoding="utf-8")
    pyplot().close(picture.figure)
    return True


def names_of(gallery: Gallery) -> str:
    """What stands for names that could not be drawn as they are."""
    changed = [look for look in gallery.looks.values() if "\\u" in look.title or "…" in look.title]
    return "".join(f" {look.title} stands for {look.label}." for look in changed)
