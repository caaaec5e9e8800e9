"""The figures of the results, each with its caption."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from bench.reporting.labels import cards, title
from bench.reporting.pictures.png import caption_of
from bench.reporting.pictures.theme import FULL

LEGIBLE = 46.0
"""Width (rem) of a figure as wide as a page below which its letters, of 7 points, are too small; it is scrolled."""
INITIALS = frozenset({"snr"})


@dataclass(frozen=True)
class PagePicture:
    """A figure: its file's bytes, its size in pixels, the first sentence of its caption and the rest.

    ``least`` is the width (rem) that it is not shown below.
    """

    name: str
    heading: str
    caption: str
    rest: str
    data: bytes
    width: int
    height: int
    least: float


def pictures(folder: Path) -> list[PagePicture]:
    """Read those of a folder, by name."""
    return [picture(path) for path in sorted(folder.glob("*.png"))] if folder.is_dir() else []


def picture(path: Path) -> PagePicture:
    """Read a figure with its caption."""
    from PIL import Image

    with Image.open(path) as image:
        (width, height), dpi = image.size, image.info.get("dpi", (100.0,))[0]
    least = round(LEGIBLE * min(1.0, 72.0 * width / dpi / FULL), 1)
    first, rest = first_sentence(caption_of(path))
    heading = " ".join(_word(word) for word in path.stem.split("_"))
    heading = heading[:1].upper() + heading[1:]
    return PagePicture(path.stem, heading, first, rest, path.read_bytes(), width, height, least)


def _word(word: str) -> str:
    """A word of a figure's name in its heading: a method by its title, initials in capitals."""
    return title(word) if word in cards() else word.upper() if word in INITIALS else word


def first_sentence(text: str) -> tuple[str, str]:
    """A caption's first sentence, and what follows it."""
    match = re.match(r"(.+?[.?!])(?:\s+(?=[A-Z0-9])(.*))?$", text, re.S)
    return (match.group(1), match.group(2) or "") if match else (text, "")
