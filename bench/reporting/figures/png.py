"""A drawing as a small PNG file that holds its caption."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

RESOLUTIONS = (200, 150)
"""Dots per inch: a later one where the file of an earlier one is larger than ``MOST_BYTES``."""
MOST_BYTES = 150_000
COLOURS = 256
KEYWORD = "Description"
"""The keyword of the PNG standard for a description of the picture."""


def png_file(figure: Any, caption: str) -> bytes:
    """Draw a figure of matplotlib with few colours; the same figure gives the same bytes."""
    from PIL import Image

    for dpi in RESOLUTIONS:
        drawn = io.BytesIO()
        figure.savefig(drawn, format="png", dpi=dpi, pil_kwargs={"compress_level": 1})
        with Image.open(drawn) as image:
            data = packed(image, dpi, caption)
        if len(data) <= MOST_BYTES:
            break
    return data


def packed(image: Any, dpi: int, caption: str) -> bytes:
    """Return the PNG file of an image, with a palette of its own."""
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    text = PngInfo()
    text.add_itxt(KEYWORD, caption)
    # not by the median cut, which gives the colours of thin lines away for shades of grey
    few = image.convert("RGB").quantize(COLOURS, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    file = io.BytesIO()
    few.save(file, "PNG", optimize=True, dpi=(dpi, dpi), pnginfo=text)
    return file.getvalue()


def caption_of(path: Path) -> str:
    """Return the caption in a PNG file; empty where it holds none."""
    from PIL import Image

    with Image.open(path) as image:
        return str(image.info.get(KEYWORD, ""))
