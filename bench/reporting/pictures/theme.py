"""Sizes, font and colours of every picture, as Vega-Lite takes them."""

from __future__ import annotations

from typing import Any

HALF, FULL = 85.0 / 25.4 * 72.0, 175.0 / 25.4 * 72.0
SMALL, NORMAL = 7.0, 7.5
"""Font sizes."""
FONT = "DejaVu Sans"
SERIES = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7F7F7F")
"""M. Okabe, K. Ito, 2008: told apart by those who see colours differently."""


def theme() -> dict[str, Any]:
    """Return the configuration of every picture; its named styles are those of marks that are not a series."""
    ink, quiet, ground, grid = "#1a1a1a", "#707070", "#ffffff", "#dddddd"
    letters = {"labelFontSize": SMALL, "titleFontSize": NORMAL, "titleFontWeight": "normal", "labelColor": ink,
               "titleColor": ink}  # fmt: skip
    return {
        "background": ground,
        "font": FONT,
        "view": {"stroke": None},
        "range": {"category": list(SERIES), "ordinal": [quiet, SERIES[0], ink]},
        "axis": {
            **letters, "domainColor": ink, "tickColor": ink, "gridColor": grid, "gridWidth": 0.5, "domainWidth": 0.6,
            "tickWidth": 0.6, "tickSize": 3, "labelPadding": 2, "titlePadding": 3, "labelLimit": 160,
        },
        "header": {
            "labelFontSize": NORMAL, "labelColor": ink, "labelPadding": 3, "title": None, "labelAnchor": "start",
            "labelExpr": "split(datum.label, '\\n')",
        },
        "legend": {
            **letters, "orient": "bottom", "title": None, "columnPadding": 12, "rowPadding": 1, "offset": 4,
            "symbolSize": 30, "labelLimit": 240,
        },
        "title": {"fontSize": NORMAL, "fontWeight": "normal", "color": ink, "anchor": "start", "offset": 3},
        "text": {"fontSize": SMALL, "color": ink},
        "mark": {"color": SERIES[0]},
        "rule": {"color": SERIES[0]},
        "line": {"strokeWidth": 1.1},
        "style": {
            "truth": {"color": ink, "strokeWidth": 0.9},
            "quiet": {"color": quiet, "strokeWidth": 0.9},
            "broad": {"color": quiet, "opacity": 0.4, "strokeWidth": 3},
            "region": {"color": quiet, "fillOpacity": 0.25, "strokeWidth": 0.8},
        },
    }  # fmt: skip
