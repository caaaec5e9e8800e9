"""Pictures by matplotlib as SVGs: those of a page follow its colours, on light ground and on dark."""

from __future__ import annotations

import io
import re
from base64 import b64encode
from importlib.resources import files
from typing import Any

INK, MUTED, LINE = "#010203", "#040506", "#070809"
SERIES = ("#0d0e01", "#0d0e02", "#0d0e03", "#0d0e04")
COLOURS = {INK: "--ink", MUTED: "--muted", LINE: "--line"} | {colour: f"--s{i}" for i, colour in enumerate(SERIES, 1)}
"""Stand-ins in a picture, and the page's colours that take their place, one set for light and one for dark."""
RC = {
    "svg.fonttype": "none", "text.color": INK, "axes.edgecolor": MUTED, "axes.labelcolor": INK, "xtick.color": MUTED,
    "ytick.color": MUTED, "grid.color": LINE, "axes.spines.right": False, "legend.frameon": False, "font.size": 10,
    "path.simplify_threshold": 0.3, "axes.titlesize": 10, "axes.titlelocation": "left", "lines.solid_capstyle": "butt",
    "text.parse_math": False, "axes.spines.top": False, "svg.hashsalt": "vibration-bench", "font.family": "sans-serif",
}  # fmt: skip


def pyplot() -> Any:
    """Return matplotlib's pyplot without a display."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot


def svg_address(figure: Any) -> str:
    """Return a figure as the address of an image, which takes the colours of light or dark ground as the page does."""
    light, dark = _colours()[:2]
    style = f"<style>{light} @media (prefers-color-scheme: dark) {{ {dark} }}</style>"
    text = _saved(figure, transparent=True).replace("<defs>", f"{style}<defs>", 1)
    text = re.sub("|".join(COLOURS), lambda match: f"var({COLOURS[match[0]]})", text)
    return f"data:image/svg+xml;base64,{b64encode(text.encode()).decode()}"


def svg_file(figure: Any) -> str:
    """Return a figure as the content of a file, in the page's colours for a light ground."""
    light = dict(re.findall(r"(--\w+): (#\w+)", _colours()[0]))
    return re.sub("|".join(COLOURS), lambda match: light[COLOURS[match[0]]], _saved(figure, transparent=False))


def _saved(figure: Any, transparent: bool) -> str:
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", transparent=transparent, metadata={"Date": None})
    pyplot().close(figure)
    return buffer.getvalue()


def _colours() -> list[str]:
    """Return the rules of the page's style sheet that set its colours: on light ground, on dark ground, on paper."""
    style = files("bench.reporting.page").joinpath("report.css").read_text(encoding="utf-8")
    return re.findall(r":root \{.*?\}", style, flags=re.DOTALL)
