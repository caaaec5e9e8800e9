"""One style for every picture: sizes, fonts, and what each method looks like wherever it is drawn.

Pictures are drawn at the size at which they are read: 85 mm (half a page) or 175 mm (its full width), with no letter
below 7 points.
"""

from __future__ import annotations

import hashlib
import io
import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from bench.reporting.figures.png import png_file
from bench.reporting.labels import cards, in_order, title
from bench.reporting.whole_file import write

MM = 1.0 / 25.4
"""Inches a millimetre."""
HALF, FULL = 85.0 * MM, 175.0 * MM
SMALL, NORMAL = 7.0, 7.5
"""Font sizes (points)."""
FONT = "DejaVu Sans"
"""It comes with matplotlib: pictures are the same on every machine."""
LONGEST = 34
"""Letters of a name that are drawn; of a longer one, its two ends."""
Marker = str | tuple[int, int, float]

MORE_COLOURS = (
    "#0077BB", "#EE7733", "#009988", "#EE3377", "#004488", "#DDAA33", "#6A3D9A", "#33BBEE", "#CC3311",
)  # fmt: skip
MORE_MARKERS: tuple[Marker, ...] = (
    (5, 0, 36.0), "|", (12, 1, 0.0), "_", (8, 2, 0.0), (5, 1, 36.0), (4, 2, 22.5), (3, 1, 60.0),
)  # fmt: skip
"""Of these are the methods whose card names none; the numbers of colours and of markers have no common factor."""
FILLED = frozenset("ov^<>8sphHDdPX*")


@dataclass(frozen=True)
class Look:
    """How a method is drawn: ``title`` is its name as letters that the font has."""

    label: str
    title: str
    colour: str
    marker: Marker

    def point(self, size: float = 4.5, hollow: bool = False) -> dict[str, Any]:
        """Properties of a marker."""
        face = "none" if hollow else self.colour
        filled = self.marker in FILLED or (isinstance(self.marker, tuple) and self.marker[1] != 2)
        edge = 0.9 if hollow or not filled else 0.4
        return {"marker": self.marker, "ms": size, "mfc": face, "mec": self.colour, "mew": edge}


def looks(labels: Iterable[str]) -> dict[str, Look]:
    """The look of every method, by label, in order: as its card says.

    What a card leaves out is of a palette by a hash of the label, the next where another has that already: up to 90
    such methods all look different.
    """
    found, taken, titles, several = {}, set[int](), set[str](), len(MORE_COLOURS) * len(MORE_MARKERS)
    for label in in_order(labels):
        card = cards().get(label)
        colour, marker = (card.colour, card.marker) if card else ("", "")
        if not (colour and marker):
            at = int.from_bytes(hashlib.sha256(label.encode()).digest()[:8], "big") % several
            at = next((i % several for i in range(at, at + several) if i % several not in taken), at)
            taken.add(at)
            colour, marker = (
                colour or MORE_COLOURS[at % len(MORE_COLOURS)],
                marker or MORE_MARKERS[at % len(MORE_MARKERS)],
            )
        name = plain = drawable(title(label))
        while name in titles:
            name = f"{plain} ({len(titles)})"
        titles.add(name)
        found[label] = Look(label, name, colour, marker)
    return found


@cache
def _glyphs() -> Any:
    from matplotlib.font_manager import findfont, get_font

    return get_font(findfont(FONT))


def drawable(text: str) -> str:
    """A name as it can be drawn: letters that the font lacks as ``\\uXXXX``, none with a meaning to matplotlib."""
    plain = "".join(" " if unicodedata.category(letter)[0] == "C" else letter for letter in text).strip() or "?"
    if len(plain) > LONGEST:
        plain = f"{plain[: LONGEST - 11]}…{plain[-10:]}"
    there = (letter if _glyphs().get_char_index(ord(letter)) else f"\\u{ord(letter):04x}" for letter in plain)
    return "".join(there).replace("$", r"\$")


def pyplot() -> Any:
    """matplotlib's pyplot without a display, in the one style of all pictures."""
    import matplotlib

    matplotlib.use("Agg")
    matplotlib.rcParams.update(
        {
            "font.family": FONT, "font.size": NORMAL, "axes.titlesize": NORMAL, "axes.labelsize": NORMAL,
            "xtick.labelsize": SMALL, "ytick.labelsize": SMALL, "legend.fontsize": SMALL, "figure.labelsize": NORMAL,
            "axes.spines.top": False, "axes.spines.right": False, "axes.linewidth": 0.6, "lines.linewidth": 1.0,
            "xtick.major.width": 0.6, "ytick.major.width": 0.6, "xtick.minor.width": 0.4, "ytick.minor.width": 0.4,
            "grid.linewidth": 0.5, "grid.color": "0.87", "axes.axisbelow": True, "hatch.linewidth": 0.5,
            "figure.constrained_layout.w_pad": 0.03, "figure.constrained_layout.h_pad": 0.03,
            "figure.max_open_warning": 0, "svg.hashsalt": "vibration-bench",
        }
    )  # fmt: skip
    from matplotlib import pyplot

    return pyplot


def panels(n: int, columns: int, height: float, xlabel: str, **shared: Any) -> tuple[Any, list[Any]]:
    """A figure of ``n`` small multiples of so many millimetres, at most ``columns`` in a row: figure and axes.

    The width is that of a full page. Axes that are left over are taken away; the lowest row has the label.
    """
    columns = min(columns, n)
    rows = -(-n // columns)
    figure, axes = pyplot().subplots(
        rows, columns, figsize=(FULL, (rows * height + 8.0) * MM), layout="constrained", squeeze=False, **shared
    )
    for axis in axes.flat[n:]:
        axis.remove()
    for axis in axes.flat[max(0, n - columns) : n]:  # the lowest of each column, also above one that is gone
        axis.tick_params(labelbottom=True)
    for axis in axes.flat[(rows - 1) * columns : n]:
        axis.set_xlabel(xlabel)
    return figure, list(axes.flat[:n])


def entry(**style: Any) -> Any:
    """A legend's entry: a line with properties of matplotlib's."""
    from matplotlib.lines import Line2D

    return Line2D([], [], **style)


def handle(look: Look, **style: Any) -> Any:
    """A legend's entry for a method."""
    return entry(color=look.colour, **{**look.point(), "lw": 1.0, "label": look.title, **style})


def legend_below(figure: Any, handles: Sequence[Any]) -> None:
    """A legend under all panels, in as many columns as fit; the figure grows by what it needs."""
    if not handles:
        return
    width, height = figure.get_size_inches()
    widths = [(width_of(h.get_label(), SMALL) + 11.0) * MM for h in handles]
    columns = next(
        (n for n in range(len(widths), 1, -1) if sum(max(own) for own in np.array_split(widths, n)) < 0.98 * width), 1
    )
    rows = -(-len(widths) // columns)
    columns = -(-len(widths) // rows)
    figure.set_size_inches(width, height + 0.155 * rows + 0.08)
    own = figure.legend(
        handles=list(handles), loc="outside lower center", ncols=columns, frameon=False,
        columnspacing=1.2, handlelength=2.0, labelspacing=0.3,
    )  # fmt: skip
    for text, h in zip(own.get_texts(), handles, strict=True):
        text.set_text(h.get_label())


def width_of(text: str, size: float = NORMAL) -> float:
    """How wide a line of text is (mm)."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    prop = FontProperties(family=FONT, size=size)
    return float(text_to_path.get_text_width_height_descent(text, prop, ismath=False)[0]) / 72.0 / MM


def wrapped(title: str, width: float) -> str:
    """A panel's title in lines of so many millimetres at most; of a longer word, its two ends."""
    lines: list[str] = []
    for word in title.split(" "):
        short, n = word, len(word)
        while width_of(short) > width and n > 8:
            n -= 1
            short = f"{word[: n - 7]}…{word[-6:]}"
        if lines and width_of(f"{lines[-1]} {short}") <= width:
            lines[-1] += f" {short}"
        else:
            lines.append(short)
    return "\n".join(lines)


def plain_logarithmic(axis: Any) -> None:
    """Ticks of a logarithmic x or y axis (``axes.xaxis``) as plain numbers: 1, 2, 5, 10 where it is short, or decades.

    Of an axis whose decades would need more than four digits or decimals, as powers of ten.
    """
    from matplotlib.ticker import FuncFormatter, LogFormatterMathtext, LogLocator, NullFormatter

    low, high = axis.get_view_interval()
    if high / low < 100.0:
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=20))
    plain = low >= 1e-4 and high < 1e5
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}") if plain else LogFormatterMathtext())
    axis.set_minor_formatter(NullFormatter())


def save_figure(figure: Any, folder: Path, name: str, caption: str, svg: Path | None = None) -> list[Path]:
    """Write a figure as a PNG file with its caption, and as SVG into a further folder where one is given; close it.

    The same figure gives the same bytes. The caption is one line, whose first sentence says what is seen.

    Returns:
        The paths of the files.
    """
    paths = [folder / f"{name}.png"]
    write(paths[0], png_file(figure, caption), folder)
    if svg is not None:
        figure.set_layout_engine("none")  # it stays as the first file laid it out
        drawn = io.BytesIO()
        figure.savefig(drawn, format="svg", metadata={"Date": None})
        paths.append(svg / f"{name}.svg")
        write(paths[1], drawn.getvalue(), svg, "svg")
    pyplot().close(figure)
    return paths
