"""``python -m bench.figures``: the pictures of a store, from its rows and arrays alone, as SVG and PNG with a caption.

A picture for which the store has nothing is left out, and one line says why.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from bench.cli import read_fields
from bench.errors import InputError
from bench.figures.band import draw_band
from bench.figures.basin import draw_basin
from bench.figures.coverage import draw_coverage
from bench.figures.failures import draw_failures
from bench.figures.forest import draw_forest
from bench.figures.gallery import Gallery, Nothing, Picture
from bench.figures.noise import draw_noise
from bench.figures.profiles import draw_profiles
from bench.figures.response import draw_reconstruction, draw_record
from bench.figures.scatter import draw_scatter
from bench.figures.style import pyplot, save_figure
from bench.figures.time import draw_time
from bench.figures.training import draw_training
from bench.figures.two_masses import draw_two_masses
from bench.store import Store
from bench.store_archive.opening import DEFAULT_STORE, open_store
from bench.terminal import command

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
    """``python -m bench.figures [store=...] [archive=...] [out=results/figures]``; exit status 2 for bad input."""
    usage = f"usage: python -m bench.figures [store={DEFAULT_STORE}] [archive=<folder>|none] [out=results/figures]"
    return command("bench.figures", f"{usage}\n\n{__doc__}", argv, _main)


def _main(arguments: Sequence[str]) -> int:
    try:
        fields = read_fields(arguments, {"store": DEFAULT_STORE, "archive": "", "out": "results/figures"})
        gallery, out = read(open_store(fields["store"], fields["archive"])), Path(fields["out"])
        Store(out).prepare()
        drawn = sum(write(gallery, name, out) for name in PICTURES)
        if not drawn:
            raise InputError("store", fields["store"], "no cell there has what a picture needs; run experiment=table5")
    except ImportError as error:
        if "matplotlib" not in str(error):
            raise
        print("bench.figures: matplotlib is missing: pip install 'vibration-bench[figures]'", file=sys.stderr)
        return 2
    return 0


def read(store: Store) -> Gallery:
    """The cells of a store; raises InputError where there is none."""
    if not store.there() or not store.identities():
        raise InputError("store", store.folder, "no cell there; run python -m bench -m experiment=table5 first")
    return Gallery(store)


def write(gallery: Gallery, name: str, out: Path) -> bool:
    """Draw one picture and write its files, saying so; whether there was something to draw."""
    try:
        picture = PICTURES[name](gallery)
    except Nothing as reason:
        print(f"bench.figures: {name}: not drawn: {reason}", file=sys.stderr)
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
