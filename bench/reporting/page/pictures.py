"""The figures beside the site: a smaller copy of each to look at, and links to the whole ones."""

from __future__ import annotations

import io
import os
import re
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

WIDTH = 900
"""Pixels across of a copy at most."""
COLOURS = 24
INITIALS = frozenset({"snr", "pinn"})


@dataclass(frozen=True)
class Picture:
    """A figure: its copy's bytes, its caption, and where its whole files are from the site's folder."""

    name: str
    heading: str
    caption: str
    rest: str
    copy: bytes
    width: int
    height: int
    whole: tuple[tuple[str, str], ...]


def pictures(folder: Path, out: Path) -> list[Picture]:
    """Those of a folder with a PNG, by name."""
    return [picture(path, out) for path in sorted(folder.glob("*.png"))] if folder.is_dir() else []


def picture(path: Path, out: Path) -> Picture:
    """A figure with its caption, the first sentence apart."""
    from PIL import Image

    with Image.open(path) as found:
        image = found.convert("RGB")
    if image.width > WIDTH:
        image = image.resize((WIDTH, round(image.height * WIDTH / image.width)), Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    image.quantize(COLOURS, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE).save(
        buffer, "PNG", optimize=True
    )
    said = path.with_suffix(".txt")
    first, rest = first_sentence(said.read_text(encoding="utf-8").strip() if said.is_file() else "")
    whole = tuple(
        (ending.removeprefix(".").upper(), quote(Path(os.path.relpath(own, out)).as_posix()))
        for ending in (".svg", ".png") if (own := path.with_suffix(ending)).is_file()
    )  # fmt: skip
    heading = " ".join(word.upper() if word in INITIALS else word for word in path.stem.split("_"))
    heading = heading[:1].upper() + heading[1:]
    return Picture(path.stem, heading, first, rest, buffer.getvalue(), image.width, image.height, whole)


def first_sentence(text: str) -> tuple[str, str]:
    """A caption's first sentence, and what follows it."""
    match = re.match(r"(.+?[.?!])(?:\s+(?=[A-Z0-9])(.*))?$", text, re.S)
    return (match.group(1), match.group(2) or "") if match else (text, "")
