"""The benchmark's picture of size with its caption, from its stored numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import altair as alt
import pandas as pd

from bench.reporting.labels import in_order, title
from bench.reporting.pictures.style import Picture, layered, logarithmic, save, table
from tests.studies.pinn.common import METHODS

SIZES = {"residuals": "residuals (−)", "masses": "masses in the chain (−)", "cycles": "cycles in the record (−)"}
LEAST, TOP = 0.7, 1.5
"""Limits of the ratios of errors that are drawn; a triangle at the edge stands for one beyond."""


def scaling_picture(data: dict[str, Any], out: Path) -> list[Path]:
    """Draw seconds a fit, and error over the oracle's, against size; the files."""
    order, columns = list(map(title, in_order(METHODS))), []
    seconds = [point["seconds"] for own in data.values() for point in own]
    times, ticks = logarithmic(0.8 * min(seconds), 1.25 * max(seconds))
    for kind, label in SIZES.items():
        frame = table(pd.DataFrame(data[kind]))
        frame = frame.assign(method=[title(name) for name in frame.method])
        sizes = sorted(set(frame["size"]))
        x = alt.X("size:Q").scale(type="log", nice=False, padding=6).axis(values=sizes, format="~g").title(label)
        ratio = alt.Y("ratio:Q").scale(domain=[LEAST, TOP], clamp=True).title("errors / oracle's (−)")
        beyond = alt.condition(f"datum.ratio > {TOP}", alt.value("triangle-up"), alt.value("circle"))
        chart = alt.Chart(frame).encode(x, alt.Color("method:N").sort(order), tooltip=list(frame.columns))
        rule = alt.Chart(pd.DataFrame({"ratio": [1.0]})).mark_rule(style="quiet")
        dots: dict[str, Any] = {"size": 14, "filled": True, "opacity": 1}
        rows = (
            [chart.mark_line(), chart.mark_point(**dots)], alt.Y("seconds:Q").scale(times).axis(ticks).title("s a fit")
        ), ([rule, chart.mark_line(), chart.mark_point(**dots).encode(shape=beyond)], ratio)  # fmt: skip
        panels = [
            layered(frame, *(own.encode(y) for own in marks)).properties(width=120, height=90) for marks, y in rows
        ]
        columns.append(alt.vconcat(*panels))
    return save(Picture("pinn_scaling", alt.hconcat(*columns, spacing=8), scaling_caption(data)), out)


def scaling_caption(data: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """Return the caption of the picture of size."""
    every = [point for own in data.values() for point in own]
    largest = {title(name): max(p["ratio"] for p in every if p["method"] == name) for name in in_order(METHODS)}
    said = "; ".join(
        f"{name} {ratio:.0f}" if ratio > 100.0 else f"{name} {ratio:.3g}" for name, ratio in largest.items()
    )
    shortest = min(point["size"] for point in data["cycles"])
    times = {p["method"]: p["seconds"] for p in data["cycles"] if p["size"] == shortest}
    slowest, fastest = max(times, key=times.__getitem__), min(times, key=times.__getitem__)
    return (
        f"A fit takes more time the larger the problem is, and {title(slowest)} takes most. Upper row: processor time "
        f"of a fit; on the shortest record {title(slowest)} takes {times[slowest] / times[fastest]:.2g} times that of "
        f"{title(fastest)}. Lower row: root mean square error of the groups over that of the oracle, which starts from "
        f"the truth, on the same data; 1 is as accurate. Largest ratio: {said}. A triangle is beyond the edge. Left: "
        "collocation points on the reference record, which only two methods have. Middle: chains, by the number of "
        "masses. Right: cycles in the record. A line ends where a fit would take minutes."
    )
