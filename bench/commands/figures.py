"""``python -m bench.figures``: the pictures of a store, from its rows and arrays alone, as PNG files with a caption.

``svg=build/figures`` draws them as SVG files, too, into that folder. A picture for which the store has nothing is left
out, and one line says why.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from bench.commands.fields import path_of, read_fields
from bench.commands.guard import command
from bench.commands.stores import FIELDS, filled_store
from bench.errors import InputError
from bench.reporting.whole_file import check_folder
from bench.store.opening import DEFAULT_STORE
from bench.store.store import Store


def main(argv: Sequence[str] | None = None) -> int:
    """``python -m bench.figures [store=...] [archive=...] [out=...] [svg=...]``; exit status 2 for bad input."""
    places = "[out=results/figures] [svg=<folder>]"
    usage = f"usage: python -m bench.figures [store={DEFAULT_STORE}] [archive=<folder>|none] {places}"
    return command("bench.figures", f"{usage}\n\n{__doc__}", argv, _main)


def _main(arguments: Sequence[str]) -> int:
    fields = read_fields(arguments, {**FIELDS, "out": "results/figures", "svg": ""})
    store, out = filled_store(fields), path_of(fields["out"])
    svg = path_of(fields["svg"]) if fields["svg"] else None
    check_folder(out)
    if svg is not None:
        check_folder(svg, "svg")
    try:
        if not _draw(store, out, svg):
            raise InputError("store", store.folder, "no cell there has what a picture needs; run experiment=table5")
    except ImportError as error:
        if "matplotlib" not in str(error):
            raise
        print("bench.figures: matplotlib is missing: pip install 'vibration-bench[figures]'", file=sys.stderr)
        return 2
    return 0


def _draw(store: Store, out: Path, svg: Path | None) -> int:
    """Draw all pictures for which the store has something; returns how many."""
    from bench.reporting.figures.gallery import Gallery, Nothing
    from bench.reporting.figures.pictures import PICTURES, write_picture

    gallery = Gallery(store)
    drawn = 0
    for name in PICTURES:
        try:
            paths = write_picture(gallery, name, out, svg)
        except Nothing as reason:
            print(f"bench.figures: {name}: not drawn: {reason}", file=sys.stderr)
            continue
        drawn += 1
        for path in paths:
            print(path)
    return drawn


if __name__ == "__main__":
    sys.exit(main())
