"""The figures beside the site: a smaller copy of each to look at, and links to the whole ones."""

from __future__ import annotations

import io
import os
import re
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from bench.reporting.labels import cards, title

WIDTH = 900
"""Pixels across of a copy at most."""
COLOURS = 64
PAGE = 1378
"""Pixels across of a figure that is a whole page wide."""
LEGIBLE = 46.0
"""Width (rem) of such a figure below which its letters, of 7 points on paper, are too small to read; it is scrolled."""
INITIALS = frozenset({"snr"})


@dataclass(frozen=True)
class Picture:
    """A figure: its copy's bytes, its caption, and where its whole files are from the site's folder.

    ``least`` is the width (rem) that it is not shown below.
    """

    name: str
    heading: str
    caption: str
    rest: str
    copy: bytes
    width: int
    height: int
    least: float
    whole: tuple[tuple[str, str], ...]


def pictures(folder: Path, out: Path) -> list[Picture]:
    """Those of a folder with a PNG, by name."""
    return [picture(path, out) for path in sorted(folder.glob("*.png"))] if folder.is_dir() else []


def picture(path: Path, out: Path) -> Picture:
    """A figure with its caption, the first sentence apart."""
    from PIL import Image

    with Image.open(path) as found:
        image = found.convert("RGB")
    least = round(LEGIBLE * min(1.0, image.width / PAGE), 1)
    if image.width > WIDTH:
        image = image.resize((WIDTH, round(image.height * WIDTH / image.width)), Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    # not by the median cut, which gives the colours of thin lines away for shades of grey
    few = image.quantize(COLOURS, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    few.save(buffer, "PNG", optimize=True)
    said = path.with_suffix(".txt")
    first, rest = first_sentence(said.read_text(encoding="utf-8").strip() if said.is_file() else "")
    whole = tuple(
        (ending.removeprefix(".").upper(), quote(Path(os.path.relpath(own, out)).as_posix()))
        for ending in (".svg", ".png") if (own := path.with_suffix(ending)).is_file()
    )  # fmt: skip
    heading = " ".join(_word(word) for word in path.stem.split("_"))
    heading = heading[:1].upper() + heading[1:]
    return Picture(path.stem, heading, first, rest, buffer.getvalue(), image.width, image.height, least, whole)


def _word(word: str) -> str:
    """A word of a figure's name in its heading: a method by its title, initials in capitals."""
    return title(word) if word in cards() else word.upper() if word in INITIALS else word


def first_sentence(text: str) -> tuple[str, str]:
    """A caption's first sentence, and what follows it."""
    match = re.match(r"(.+?[.?!])(?:\s+(?=[A-Z0-9])(.*))?$", text, re.S)
    return (match.group(1), match.group(2) or "") if match else (text, "")
