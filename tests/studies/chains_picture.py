"""The picture of the chains: what a fit costs as they grow, and how far from the bound each method is at each size."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bench.contract.estimate import Status
from bench.entrants.reference import REFERENCES
from bench.reporting.figures.beside import Name, height_of, name_beside
from bench.reporting.figures.style import (
    FULL,
    MM,
    SMALL,
    Look,
    entry,
    legend_below,
    looks,
    plain_logarithmic,
    pyplot,
    save_figure,
)

ROW, LEAST = 5.0, 60.0
"""Height of a row, and least height of the panels (mm)."""
ASTRAY = 3.0
"""An excess of the displacement error from which on a method is said to have missed the solution."""
DARKEST = 100.0
"""The excess from which on the shade does not change."""


def picture(data: pd.DataFrame, out: Path) -> list[Path]:
    """Draw time against size, and the excess of the displacement as a table; return the files."""
    order = reaching(data)
    look = looks(data.method)
    names = _ends(data, [look[method] for method in order if method not in REFERENCES])
    height = max(LEAST, ROW * len(order), height_of(names))
    figure, (left, right) = pyplot().subplots(
        1, 2, figsize=(FULL, (height + 18.0) * MM), layout="constrained", width_ratios=(0.5, 0.5)
    )
    _times(left, data, [look[method] for method in order if method not in REFERENCES])
    name_beside(left, names, height)
    _excesses(right, data, [look[method] for method in order])
    legend_below(figure, _handles(data))
    return save_figure(figure, out, "chains", caption(data))


def caption(data: pd.DataFrame) -> str:
    """Return the caption of the picture."""
    longest = int(data.n.max())
    there = data[(data.n == longest) & ~data.method.isin(REFERENCES) & (data.n_ok == data.n_fits) & (data.n_fits > 0)]
    near = [look.title for look in looks(there[there.rmse_excess < ASTRAY].method).values()]
    said = f"Up to {longest} masses" if longest > 1 else "One mass"
    lead = f"{said}: {' and '.join(near) or 'no method'} solved it every time."
    return (
        f"{lead} Left: median processor time of a fit against the number of masses, each line up to the longest chain "
        "that the method answered. Right: root mean square error of the displacement over the Cramér-Rao bound, by "
        "the number of masses, of the fits that succeeded; 1 is the best that the data allow, and dark is far from "
        "it. A star: some fits gave no answer. Methods in order of the longest chain that they solved, that is, every "
        f"time with an excess below {ASTRAY:g}; then of the longest that they answered."
    )


def reaching(data: pd.DataFrame) -> list[str]:
    """Methods by the longest chain solved, then by the longest one answered; none without any answer."""
    answered = data[data.n_ok > 0]
    solved = answered[(answered.n_ok == answered.n_fits) & (answered.rmse_excess < ASTRAY)]
    reach = {str(method): (0, int(n)) for method, n in answered.groupby("method", sort=False).n.max().items()}
    reach |= {str(method): (int(n), reach[str(method)][1]) for method, n in solved.groupby("method").n.max().items()}
    return sorted(reach, key=lambda method: reach[method], reverse=True)


def _times(axis: Any, data: pd.DataFrame, shown: Sequence[Look]) -> None:
    for look in shown:
        own = data[(data.method == look.label) & (data.n_ok > 0)]
        axis.plot(own.n, own.cpu_s, color=look.colour, lw=1.0, **look.point(4.0), zorder=4)
    axis.set(xscale="log", yscale="log", xlabel="masses in the chain (−)", ylabel="processor time of a fit (s)")
    axis.minorticks_off()
    axis.set_xticks(sorted(set(data.n)), [f"{n}" for n in sorted(set(data.n))])
    axis.set(xlim=_reach(data.n), ylim=_reach(data.cpu_s[~data.method.isin(REFERENCES)]))
    plain_logarithmic(axis.yaxis)
    axis.grid()


def _reach(values: pd.Series) -> tuple[float, float]:
    """The limits of a logarithmic axis."""
    good = values[values > 0]
    low, high = (float(good.min()), float(good.max())) if len(good) else (1.0, 1.0)
    return low / 1.4, high * 1.4


def _ends(data: pd.DataFrame, shown: Sequence[Look]) -> list[Name]:
    """The name of every line, and where it ends."""
    x, y = np.log(_reach(data.n)), np.log(_reach(data.cpu_s[~data.method.isin(REFERENCES)]))
    found = []
    for look in shown:
        own = data[(data.method == look.label) & (data.n_ok > 0) & (data.cpu_s > 0)]
        if len(own):
            at = own.iloc[-1]
            parts = [(math.log(value) - low) / (high - low) for value, (low, high) in ((at.n, x), (at.cpu_s, y))]
            found.append(Name(look.title, parts[0], parts[1], look.colour))
    return found


def _excesses(axis: Any, data: pd.DataFrame, shown: Sequence[Look]) -> None:
    """A table: a row a method, a column a size."""
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    sizes = sorted(set(data.n))
    cells = {(at["method"], at["n"]): at for at in data.to_dict("records")}
    values = np.full((len(shown), len(sizes)), np.nan)
    for row, look in enumerate(shown):
        for column, n in enumerate(sizes):
            at = cells.get((look.label, n), {"status": "not tried"})
            if at.get("n_ok", 0) > 0:
                values[row, column] = max(at["rmse_excess"], 1.0)
            dark = math.isfinite(values[row, column]) and values[row, column] > math.sqrt(DARKEST)
            style = {"ha": "center", "va": "center", "fontsize": SMALL, "color": "white" if dark else "black"}
            axis.text(column, row, _text(at), **style)
    colours = ListedColormap(colormaps["OrRd"](np.linspace(0.0, 0.9, 256)))
    axis.imshow(np.log(values), cmap=colours, vmin=0.0, vmax=math.log(DARKEST), aspect="auto")
    axis.set_xticks(range(len(sizes)), [f"{n}" for n in sizes])
    axis.set_yticks(range(len(shown)), [look.title for look in shown])
    axis.tick_params(length=0)
    axis.set_xlabel("masses in the chain (−)")
    axis.set_title("displacement error / bound (−)", loc="left")


def _text(at: Mapping[Any, Any]) -> str:
    """Return the text of a cell: the excess, or why there is none."""
    if at["status"] == "not tried":
        return ""
    if at["status"] == Status.UNSUPPORTED.value:
        return "–"
    if not at["n_ok"]:
        return "×"
    value = at["rmse_excess"]
    number = f"{value:.2f}" if value < 10 else f"{value:.0f}"
    return number + ("*" if at["n_ok"] < at["n_fits"] else "")


def _handles(data: pd.DataFrame) -> list[Any]:
    """Explain the signs that are in the table."""
    texts = {_text(at)[-1:] for at in data.to_dict("records")}
    said = {"×": "no answer within the limits", "–": "unsupported", "*": "some fits gave no answer"}
    return [entry(ls="none", label=f"{sign}  {text}") for sign, text in said.items() if sign in texts]
