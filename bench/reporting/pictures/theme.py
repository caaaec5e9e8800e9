"""Sizes, font and colours of every picture, as Vega-Lite takes them."""

from __future__ import annotations

from typing import Any

HALF, FULL = 85.0 / 25.4 * 72.0, 175.0 / 25.4 * 72.0
SMALL, NORMAL = 7.0, 7.5
"""Font sizes."""
FONT = "DejaVu Sans"
SERIES = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7F7F7F")
"""M. Okabe, K. Ito, 2008: told apart by those who see colours differently."""
INK, QUIET, GROUND, GRID = "#1a1a1a", "#707070", "#ffffff", "#dddddd"
LETTERS = {"labelFontSize": SMALL, "titleFontSize": NORMAL, "titleFontWeight": "normal", "labelColor": INK,
           "titleColor": INK}  # fmt: skip
THEME: dict[str, Any] = {
    "background": GROUND,
    "font": FONT,
    "view": {"stroke": None},
    "range": {"category": list(SERIES), "ordinal": [QUIET, SERIES[0], INK]},
    "axis": {
        **LETTERS, "domainColor": INK, "tickColor": INK, "gridColor": GRID, "gridWidth": 0.5, "domainWidth": 0.6,
        "tickWidth": 0.6, "tickSize": 3, "labelPadding": 2, "titlePadding": 3, "labelLimit": 160,
    },
    "header": {
        "labelFontSize": NORMAL, "labelColor": INK, "labelPadding": 3, "title": None, "labelAnchor": "start",
        "labelExpr": "split(datum.label, '\\n')",
    },
    "legend": {
        **LETTERS, "orient": "bottom", "title": None, "columnPadding": 12, "rowPadding": 1, "offset": 4,
        "symbolSize": 30, "labelLimit": 240,
    },
    "title": {"fontSize": NORMAL, "fontWeight": "normal", "color": INK, "anchor": "start", "offset": 3},
    "text": {"fontSize": SMALL, "color": INK},
    "mark": {"color": SERIES[0]},
    "rule": {"color": SERIES[0]},
    "line": {"strokeWidth": 1.1},
    "style": {
        "truth": {"color": INK, "strokeWidth": 0.9},
        "quiet": {"color": QUIET, "strokeWidth": 0.9},
        "broad": {"color": QUIET, "opacity": 0.4, "strokeWidth": 3},
        "region": {"color": QUIET, "fillOpacity": 0.25, "strokeWidth": 0.8},
    },
}  # fmt: skip
"""Configuration of every picture; its named styles are those of marks that are not a series."""
