"""Pictures by matplotlib as small SVGs: inline ones take their colours from the page, light and dark in one."""

from __future__ import annotations

import io
import re
from importlib.resources import files
from typing import Any

INK, MUTED, LINE, SURFACE = "#010203", "#040506", "#070809", "#0a0b0c"
SERIES = ("#0d0e01", "#0d0e02", "#0d0e03", "#0d0e04")
COLOURS = {INK: "--ink", MUTED: "--muted", LINE: "--line", SURFACE: "--surface"} | {
    colour: f"--s{i}" for i, colour in enumerate(SERIES, 1)
}
"""Stand-ins in a picture, and the page's colours that take their place, one set for light and one for dark."""
RC = {
    "svg.fonttype": "none", "text.color": INK, "axes.edgecolor": MUTED, "axes.labelcolor": INK, "xtick.color": MUTED,
    "ytick.color": MUTED, "grid.color": LINE, "axes.spines.right": False, "legend.frameon": False, "font.size": 10,
    "path.simplify_threshold": 0.3, "axes.titlesize": 10, "axes.titlelocation": "left", "savefig.transparent": True,
    "text.parse_math": False, "axes.spines.top": False, "svg.hashsalt": "vibration-bench", "font.family": "DejaVu Sans",
}  # fmt: skip


def pyplot() -> Any:
    """matplotlib's pyplot without a display."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot


def row_axis(axis: Any) -> None:
    """Draw an axis whose rows have names: no ticks there, and a grid of values behind what is drawn."""
    axis.tick_params(axis="y", length=0)
    axis.grid(axis="x", lw=0.5)
    axis.set_axisbelow(True)


def svg(figure: Any, title: str, name: str) -> str:
    """A figure as an inline SVG element of its own name space, without what HTML does not need."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    pyplot().close(figure)
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->|<style.*?</style>", "", text, flags=re.S)
    text = re.sub(r' (?:d|x|y|transform|points)="[^"]*"', lambda m: re.sub(r"(\d\.\d)\d+", r"\1", m.group(0)), text)
    text = re.sub(r"font: [^;\"]*?(\d+(?:\.\d+)?)px[^;\"]*", r"font-size: \1px", text)
    text = re.sub(r" font-family: [^;\"]*;|; stroke-linejoin: miter| transform=\"rotate\(-?0 [^\"]*\"", "", text)
    text = text.replace("xlink:href", "href").replace("; stroke-linecap: square", "")
    for stand_in, variable in COLOURS.items():
        text = text.replace(stand_in, f"var({variable})")
    used = set(re.findall(r'(?:href="#|url\(#)([^")]+)', text))
    text = re.sub(r' id="([^"]*)"', lambda m: f' id="{name}-{m.group(1)}"' if m.group(1) in used else "", text)
    text = re.sub(r'(href="#|url\(#)', rf"\g<1>{name}-", text)
    text = re.sub(r"\s*\n\s*(?=[LMCQzZ\"])", "", re.sub(r"[ \t]*\n\s*", "\n", text))
    text = re.sub(r"([LMCQ]) ", r"\1", re.sub(r"<defs>\s*</defs>\n?", "", text)).strip()
    size = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', text)
    box = f'viewBox="0 0 {size.group(1)} {size.group(2)}"' if size else ""
    return re.sub(r"<svg[^>]*>", f'<svg {box} role="img" aria-label="{_plain(title)}">', text, count=1)


def svg_file(figure: Any) -> str:
    """A figure as the content of a file, in the page's colours for a light ground."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", transparent=False, metadata={"Date": None})
    pyplot().close(figure)
    text, light = buffer.getvalue(), _light()
    for stand_in, variable in COLOURS.items():
        text = text.replace(stand_in, light[variable])
    return text


def _light() -> dict[str, str]:
    """The page's colours by the names of their variables; those for a dark ground stand behind them."""
    style = files("bench.reporting.page").joinpath("report.css").read_text(encoding="utf-8")
    return dict(reversed(re.findall(r"(--\w+): (#\w+)", style)))


def _plain(text: str) -> str:
    return text.replace("&", "and").replace("<", "").replace(">", "").replace('"', "")
