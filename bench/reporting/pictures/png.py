"""A drawing as a small PNG file that holds its caption."""

from __future__ import annotations

import io
from pathlib import Path

RESOLUTION = 200
"""Dots per inch."""
KEYWORD = "Description"
"""The keyword of the PNG standard for a description of the picture."""


def packed(png: bytes, caption: str) -> bytes:
    """Return a PNG file with its caption and a palette of its own."""
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    text, file = PngInfo(), io.BytesIO()
    text.add_itxt(KEYWORD, caption)
    with Image.open(io.BytesIO(png)) as image:
        # not by the median cut, which gives the colours of thin lines away for shades of grey
        few = image.convert("RGB").quantize(256, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    few.save(file, "PNG", optimize=True, dpi=(RESOLUTION, RESOLUTION), pnginfo=text)
    return file.getvalue()


def caption_of(path: Path) -> str:
    """Return the caption in a PNG file; empty where it holds none."""
    from PIL import Image

    with Image.open(path) as image:
        return str(image.info.get(KEYWORD, ""))
