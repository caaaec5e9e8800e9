"""The picture of the chains: how far from the bound each method is at each size, and what a fit costs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import altair as alt
import pandas as pd

from bench.contract.estimate import Status
from bench.entrants.reference import REFERENCES
from bench.reporting.labels import in_order, title
from bench.reporting.pictures.maps import heat
from bench.reporting.pictures.style import Picture, save

ASTRAY = 3.0
"""An excess of the displacement error from which on a method is said to have missed the solution."""
PALEST, DARKEST = 1.2, 100.0
"""Excesses between which the shade changes."""
SIGNS = {"×": "no answer within the limits", "–": "unsupported", "*": "some fits gave no answer"}


def picture(data: pd.DataFrame, out: Path) -> list[Path]:
    """Draw the excess of the displacement and the time of a fit as two tables; return the files."""
    order, lines = reaching(data), []
    for at in data[data.method.isin(order)].to_dict("records"):
        solved = at["n_ok"] > 0
        lines.append(
            {
                "row": title(at["method"]), "column": f"{at['n']}", "excess": _excess(at), "seconds": _seconds(at),
                "above 1": max(at["rmse_excess"], PALEST) if solved else None,
                "cost": at["cpu_s"] if solved and at["method"] not in REFERENCES else None,
            }
        )  # fmt: skip
    frame, sizes = pd.DataFrame(lines), [f"{n}" for n in sorted(set(data.n))]
    if not lines:
        return []
    sides = [
        heat(frame.assign(shown=frame[shown]), list(map(title, order)), sizes, value, domain=domain, type="log")
        .properties(title=heading, width=150)
        for heading, shown, value, domain in (
            ("displacement error / bound (−), by masses", "excess", "above 1", [PALEST, DARKEST]),
            ("processor time of a fit (s), by masses", "seconds", "cost", [0.01, 100.0]),
        )
    ]  # fmt: skip
    drawn = alt.hconcat(*sides, spacing=14).resolve_scale(color="independent")
    return save(Picture("chains", drawn, caption(data)), out)


def caption(data: pd.DataFrame) -> str:
    """Return the caption of the picture."""
    longest = int(data.n.max())
    there = data[(data.n == longest) & ~data.method.isin(REFERENCES) & (data.n_ok == data.n_fits) & (data.n_fits > 0)]
    near = list(map(title, in_order(there[there.rmse_excess < ASTRAY].method)))
    said = f"Up to {longest} masses" if longest > 1 else "One mass"
    signs = {_excess(at)[-1:] for at in data.to_dict("records")}
    explained = "; ".join(f"{sign} {text}" for sign, text in SIGNS.items() if sign in signs)
    return (
        f"{said}: {' and '.join(near) or 'no method'} solved it every time. Left: root mean square error of the "
        "displacement over the Cramér-Rao bound, by the number of masses, of the fits that succeeded; 1 is the best "
        f"that the data allow, and dark is far from it{f' ({explained})' if explained else ''}. Right: median "
        "processor time of a fit. Methods in order of the longest chain that they solved, that is, every time with an "
        f"excess below {ASTRAY:g}; then of the longest that they answered."
    )


def reaching(data: pd.DataFrame) -> list[str]:
    """Methods by the longest chain solved, then by the longest one answered; none without any answer."""
    answered = data[data.n_ok > 0]
    solved = answered[(answered.n_ok == answered.n_fits) & (answered.rmse_excess < ASTRAY)]
    reach = {str(method): (0, int(n)) for method, n in answered.groupby("method", sort=False).n.max().items()}
    reach |= {str(method): (int(n), reach[str(method)][1]) for method, n in solved.groupby("method").n.max().items()}
    return sorted(reach, key=lambda method: reach[method], reverse=True)


def _excess(at: Mapping[Any, Any]) -> str:
    """Return the excess, or why there is none."""
    if at["status"] == "not tried":
        return ""
    if at["status"] == Status.UNSUPPORTED.value:
        return "–"
    if not at["n_ok"]:
        return "×"
    value = at["rmse_excess"]
    number = f"{value:.2f}" if value < 10 else f"{value:.0f}"
    return number + ("*" if at["n_ok"] < at["n_fits"] else "")


def _seconds(at: Mapping[Any, Any]) -> str:
    """Return the time of a fit; nothing without one, or of a reference row."""
    seconds = at["cpu_s"]
    there = at["n_ok"] > 0 and at["method"] not in REFERENCES and math.isfinite(seconds)
    if not there:
        return ""
    return "<0.001" if seconds < 0.001 else f"{seconds:.3f}" if seconds < 0.1 else f"{seconds:.3g}"
