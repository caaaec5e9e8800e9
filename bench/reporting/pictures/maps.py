"""Figures in two dimensions: scatter of estimates, the basin of the likelihood, failures, and the atlas."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from textwrap import fill
from typing import Any

import altair as alt
import numpy as np
import pandas as pd

from bench.atlas.axes import Axis
from bench.atlas.design import Slice
from bench.contract.estimate import Status
from bench.dynamics.simulate import simulate
from bench.entrants.registry import load_method
from bench.reporting.atlas import NEAR, RARE, near
from bench.reporting.frame import Result
from bench.reporting.labels import in_order, title
from bench.reporting.pictures.gallery import METRICS, Arrays, C, Gallery, K, replicates, where
from bench.reporting.pictures.responses import samples_of
from bench.reporting.pictures.style import ONE, Nothing, Picture, layered, logarithmic, table
from bench.reporting.pictures.theme import SERIES
from bench.reporting.rounding import readable

LEVEL = 5.991
"""The 95 % quantile of chi-squared with two degrees of freedom."""
REACH = 4.5
"""Half the width of a panel of the scatter, in standard deviations of the bound."""


def bound_covariance(cell: Result) -> np.ndarray:
    """Return the bound on the covariance of (log k/m, log c/m), (2, 2).

    It follows from the stored bounds: with ``ζ = (c/m) / 2 (k/m)^(1/2)``, ``var log ζ = var log c/m + var log k/m / 4 -
    cov(log k/m, log c/m)``.
    """
    k, c, zeta = (cell.bound(f"{name}_error_pct") / 100.0 for name in (K, C, "damping_ratio"))
    cross = c**2 + k**2 / 4.0 - zeta**2
    return np.array([[k**2, cross], [cross, c**2]])


def ellipse(covariance: np.ndarray, points: int = 61) -> np.ndarray:
    """Return errors (%) on the 95 % ellipse of two normal log-errors of mean zero, shape (2, points)."""
    angle = np.linspace(0.0, 2.0 * np.pi, points)
    circle = np.sqrt(LEVEL) * np.stack([np.cos(angle), np.sin(angle)])
    return np.asarray(100.0 * np.expm1(np.linalg.cholesky(covariance + 1e-18 * np.eye(2)) @ circle))


def draw_scatter(gallery: Gallery) -> Picture:
    """Draw the errors of k/m and c/m of every replicate, one panel per method, and the 95 % ellipse of the bound."""
    scene = (cell for cell in gallery.scene(gallery.main) if cell.label != "prior")
    cells = [cell for cell in scene if cell.successful(f"{K}_ratio").size and cell.bound(METRICS[C]) > 0]
    if not cells:
        raise Nothing("no estimates of k/m and c/m with a bound are stored")
    covariance, parts = bound_covariance(cells[0]), []
    reach = 100.0 * REACH * np.sqrt(np.diag(covariance))
    for cell in sorted(cells, key=lambda cell: gallery.ordered(cells).index(title(cell.label))):
        errors = 100.0 * (np.stack([cell.successful(f"{name}_ratio") for name in (K, C)], axis=1) - 1.0)
        outside = np.any(abs(errors) > reach, axis=1)
        name = fill(title(cell.label), 15) + (f"\n{outside.sum()} outside" if any(outside) else "")
        place = np.where(outside, "beyond the edge", "on the panel")
        parts.append(pd.DataFrame(errors, columns=["k/m", "c/m"]).assign(method=name, place=place))
    frame = table(pd.concat(parts))
    x, y = (
        kind(f"{name}:Q").scale(domain=[-end, end], clamp=True, nice=False).title(heading).axis(tickCount=3)
        for kind, name, end, heading in zip(
            (alt.X, alt.Y), ("k/m", "c/m"), reach.tolist(), ("error of k/m (%)", "of c/m (%)"), strict=True
        )
    )
    points = ellipse(covariance) if np.isfinite(covariance).all() else np.zeros((2, 0))
    region = pd.DataFrame(points.T, columns=["k/m", "c/m"]).reset_index(names="order")
    hue = alt.Color("place:N").sort("descending")
    truth = alt.Chart(ONE).mark_point(shape="cross", filled=True, size=20, style="truth")
    layers = layered(
        frame,
        alt.Chart(table(region)).mark_line(style="region", filled=True).encode(x, y, order="order:Q"),
        alt.Chart(frame)
        .mark_point(filled=True, size=8, opacity=0.7)
        .encode(x, y, hue, tooltip=["method", "k/m", "c/m"]),
        truth.encode(x=alt.datum(0), y=alt.datum(0)),
    ).properties(width=70, height=58)
    facet = alt.Facet("method:N").sort(list(dict.fromkeys(frame.method)))
    beyond = frame.groupby("method").place.apply(lambda place: (place == "beyond the edge").mean())
    return Picture(
        "scatter",
        layers.facet(facet, columns=min(6, len(cells)), spacing={"row": 4, "column": 8}),
        f"{(beyond < 0.05).sum()} of {len(cells)} methods have fewer than 5 % of their estimates beyond {REACH:g} "
        f"standard deviations of the bound. Each point is one replicate ({where(cells[0])}; {replicates(cells)} per "
        "method). The ellipse contains 95 % of the estimates of an unbiased method at the Cramér-Rao bound; a shifted "
        "cloud is biased, a larger one loses information. Estimates outside of a panel are drawn at its edge and "
        "counted. The paper's Figure 7 shows one estimate of each group.",
    )


# ------------------------------------------------------------------------------------------------ the basin

FAR = np.array([8.0, 30.0])
"""Range of the wide panel: factors about the true k/m and c/m."""
FLOOR = 5.0
"""Range of the narrow panel, in standard deviations of the bound."""
POINTS, LINES, APART = 81, 12, 0.2


def misfit(cell: Result, arrays: Arrays, k: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Return the root mean square residual (m) of the samples over k/m (nk,) and c/m (nc,), shape (nc, nk).

    An unknown initial state is fitted for each pair; the response is linear in it.
    """
    times, values = samples_of(arrays, 0)
    p = {"m": np.ones((c.size, k.size)), "k": np.tile(k, (c.size, 1)), "c": np.tile(c[:, None], (1, k.size))}

    def response(x0: float, v0: float) -> np.ndarray:
        state = (np.full((1, c.size, k.size), x0), np.full((1, c.size, k.size), v0))
        return np.asarray(simulate(cell.model, p, state, times).displacement[0])

    if (start := cell.known_initial_state) is not None:
        residual = response(float(start.displacement[0]), float(start.velocity[0])) - values
    else:
        basis = np.stack([response(1.0, 0.0), response(0.0, 1.0)], axis=-1)
        residual = (basis @ (np.linalg.pinv(basis) @ values[:, None]))[..., 0] - values
    return np.asarray(np.sqrt(np.mean(residual**2, axis=-1)))


def contours(k: np.ndarray, c: np.ndarray, surface: np.ndarray, levels: Iterable[float]) -> pd.DataFrame:
    """Return the contour lines of a surface (nc, nk): points with level and number of the line."""
    from contourpy import contour_generator

    lines = [(level, line) for level in levels for line in contour_generator(k, c, surface).lines(level)]
    parts = [
        pd.DataFrame(np.asarray(line), columns=["k/m", "c/m"]).assign(misfit=level, line=i, order=range(len(line)))
        for i, (level, line) in enumerate(lines)
    ]
    return table(pd.concat(parts))


def draw_basin(gallery: Gallery) -> Picture:
    """Draw the basin with other minima on the left, and its floor with the 95 % region on the right."""
    cells = [cell for cell in gallery.main if cell.kind == "sdof" and not cell.forced]
    if not cells:
        raise Nothing("no record of one mass in free vibration is stored")
    recorded = gallery.recorded(gallery.scene(cells))
    cell, arrays = recorded[0]
    centre = np.array([float(cell.parameters[name]) / float(cell.parameters["m"]) for name in "kc"])
    frame = np.exp(FLOOR * np.array([cell.bound(METRICS[name]) / 100.0 for name in (K, C)]))
    ends = [(fit.label, *centre * (fit.first(f"{K}_ratio"), fit.first(f"{C}_ratio"))) for fit, _ in recorded]
    points = pd.DataFrame(ends, columns=["label", "k/m", "c/m"]).query("`k/m` > 0 and `c/m` > 0")
    points["method"] = points.label.map(title)
    best = misfit(cell, arrays, *np.geomspace(centre / frame, centre * frame, POINTS).T).min()
    limit = best * math.exp(0.5 * LEVEL / arrays["sample_values"].size)  # edge of the likelihood's 95 % region
    heights = [misfit(cell, arrays, pair[:1], pair[1:]).item() for pair in points[["k/m", "c/m"]].to_numpy()]
    points["outside"] = np.array(heights) > limit
    sides = [
        _basin(cell, arrays, points, centre, factors, limit).properties(width=150, height=190, title=heading)
        for heading, factors in (("the whole basin", FAR), ("its floor", frame))
    ]
    return Picture(
        "basin",
        alt.hconcat(*sides, spacing=14).resolve_scale(color="independent"),
        f"The estimates of {(~points.outside).sum()} of {len(points)} methods lie inside the 95 % region of one basin. "
        f"Contours of the root mean square residual over k/m and c/m ({where(cell)}; replicate 0). Left: away from the "
        "basin the surface is flat with local minima, so a descent from there may not reach the basin. Right: its "
        "floor; dashed: 95 % region of the likelihood. Dots: estimates of the methods, with names outside of the "
        "region; cross: true values. The paper's Figure 8 shows estimates from several initial guesses and calls their "
        "closeness stability, which is not their error.",
    )


def _basin(
    cell: Result, arrays: Arrays, points: pd.DataFrame, centre: np.ndarray, factors: np.ndarray, limit: float
) -> Any:
    """Draw contours of the residual within factors about the true values, the 95 % region, and the estimates."""
    k, c = np.geomspace(centre / factors, centre * factors, POINTS).T
    surface = misfit(cell, arrays, k, c)
    (across, axis_k), (up, axis_c) = (logarithmic(values[0], values[-1]) for values in (k, c))
    x, y = (
        alt.X("k/m:Q").scale(across).axis(axis_k).title("k/m (1/s²)"),
        alt.Y("c/m:Q").scale(up).axis(axis_c).title("c/m (1/s)"),
    )
    hue = alt.Color("misfit:Q").scale(range=["#0072B2", "#c0c0c0"])
    legend = hue.legend(title="root mean square misfit (m)", gradientLength=90, gradientThickness=5)
    levels = np.linspace(surface.min(), surface.max(), LINES + 2)[1:-1].tolist()
    on_floor = bool(factors[0] < FAR[0])
    points[["x", "y"]] = np.log(points[["k/m", "c/m"]] / centre) / np.log(factors)  # -1 to 1 over the panel
    points = points[(abs(points.x) < 1.0) & (abs(points.y) < 1.0)]
    outside = points[points.outside & on_floor].sort_values("y")
    groups = outside.groupby(((outside.y.diff() > APART) | (abs(outside.x.diff()) > 5.5 * APART)).cumsum())
    named = groups.agg({"k/m": "max", "c/m": "mean", "x": "max", "method": list})
    named["method"] = [names if len(names) < 3 else f"{len(names)} methods" for names in named.method]
    side, away = (alt.expr(f"datum.x > 0.5 ? {choice}") for choice in ("'right' : 'left'", "-6 : 6"))
    dots, names = (alt.Chart(table(data)).encode(x, y, tooltip=["method", "k/m", "c/m"]) for data in (points, named))
    truth = alt.Chart(table(pd.DataFrame([centre], columns=["k/m", "c/m"])))
    lines = [alt.Chart(contours(k, c, surface, heights)).encode(x, y, detail="line:N", order="order:Q")
             for heights in (levels, [limit])]  # fmt: skip
    return alt.layer(
        lines[0].mark_line(strokeWidth=0.8).encode(legend, tooltip=["misfit"]),
        *([lines[1].mark_line(style="truth", strokeDash=[4, 2])] if on_floor else []),
        dots.mark_point(filled=True, opacity=0.8, size=20, color=SERIES[1]),
        names.mark_text(align=side, dx=away, lineHeight=8, baseline="middle", limit=90).encode(text="method:N"),
        truth.mark_point(shape="cross", filled=True, size=40, style="truth", opacity=1).encode(x, y),
    )


# ------------------------------------------------------------------------------------------------ failures

ABSENT = frozenset({Status.UNSUPPORTED, Status.MISSING_DEPENDENCY})
FAILURES = frozenset(Status) - ABSENT - {Status.OK}


def heat(frame: pd.DataFrame, rows: Sequence[str], columns: Sequence[str], value: str, **scale: Any) -> Any:
    """Draw a heat map from the columns ``row``, ``column``, a value, and the text ``shown``."""
    grid: dict[str, Any] = {"ticks": False, "domain": False, "grid": True, "bandPosition": 0}
    chart = alt.Chart(table(frame)).encode(
        alt.X("column:N").sort(list(columns)).title(None).axis(orient="top", labelAngle=-90, **grid),
        alt.Y("row:N").sort(list(rows)).title(None).axis(**grid),
        tooltip=list(frame.columns),
    )
    coloured = chart.transform_filter(f"isValid(datum['{value}'])")
    hue = alt.Color(f"{value}:Q").scale(range=["#fee8c8", "#f0765a"], clamp=True, **scale).legend(None)
    plain = chart.transform_filter(f"!isValid(datum['{value}'])").mark_text().encode(text="shown:N")
    text = coloured.mark_text(color="#1a1a1a").encode(text="shown:N")
    return layered(chart.data, coloured.mark_rect().encode(hue), text, plain).properties(width=300, height=alt.Step(11))


def draw_failures(gallery: Gallery) -> Picture:
    """Draw the shares of failed fits, one row per system and disturbance, one column per method."""
    lines = [
        (readable(cell.system) + (f", {readable(cell.disturbance)}" if cell.disturbance else ""), cell.label,
         100.0 * float(np.mean([status in FAILURES for status in cell.statuses])), bool({*cell.statuses} - ABSENT))
        for cell in gallery.cells if cell.n
    ]  # fmt: skip
    worst = pd.DataFrame(lines, columns=["row", "label", "failed", "tried"]).groupby(["row", "label"]).max()
    tests, bad = worst.index.unique("row"), worst[worst.failed > 0.0]
    if bad.empty:
        raise Nothing("no replicate of any cell failed")
    rows, labels = sorted(bad.index.unique("row")), in_order(bad.index.unique("label"))
    frame = worst.reindex(pd.MultiIndex.from_product([rows, labels], names=["row", "label"])).reset_index()
    share = frame.failed.map(lambda failed: f"{failed:.0f}" if failed >= 1.0 else "<1")
    cases = [frame.failed.isna(), frame.tried == False, frame.failed == 0.0]  # noqa: E712 - or not there
    frame["shown"] = np.select(cases, ["·", "–", ""], share)
    frame["column"], frame["failed"] = frame.label.map(title), frame.failed.where(frame.failed > 0.0)
    frame = frame[["row", "column", "failed", "shown"]]
    used = Counter(status for cell in gallery.cells for status in cell.statuses)
    kinds = ", ".join(f"{used[status]} {status}" for status in Status if status in FAILURES and used[status])
    return Picture(
        "failures",
        heat(frame, rows, list(map(title, labels)), "failed", domain=[0, 100]),
        f"Fits failed in {len(rows)} of {len(tests)} kinds of test. One row per system and disturbance: share (%) of "
        "failed fits, at the noise level and initial state where it is largest. Dash: data that the method does not "
        "support; dot: not run. Tests and methods without any failure are left out. Of all "
        f"{sum(used.values())} replicates: {kinds}.",
    )


# ------------------------------------------------------------------------------------------------ the atlas

AXES = {"samples": "samples (−)", "cycles": "cycles (−)", "damping_ratio": "damping ratio (−)", "snr_db": "SNR (dB)"}
BOUNDS = {
    "bound_k_over_m": "bound on k/m", "bound_c_over_m": "bound on c/m", "wrong_basin": "wrong basin of the likelihood"
}  # fmt: skip
LEVELS = {"below 0.1 %": 0.1, "below 1 %": 1.0, "below 10 %": 10.0, "below 100 %": 100.0, "above": math.inf}
BLUES = ("#eff3ff", "#bdd7e7", "#6baed6", "#3182bd", "#08519c")
GOOD, FARTHER = f"error ≤ {NEAR:g} × bound", "larger error"
SOME, MOSTLY, ABOVE = f"outliers over {100 * RARE:g} %", "over 50 %", "above Nyquist"
STATES = {GOOD: "#1a9850", FARTHER: "#a6d96a", SOME: "#fdae61", MOSTLY: "#d73027", ABOVE: "#9e9e9e"}
"""States of a method at a point of the atlas, from best to worst, with their colours."""


def draw_atlas(plane: Slice, frame: pd.DataFrame) -> Picture:
    """Draw the bounds and the state of each method over a slice of the atlas."""
    axes = plane.axes()
    names = [axis.name for axis in axes]
    first = frame[frame.method == frame.method.iloc[0]]
    bounds = first.melt(names, [name for name in BOUNDS if name in first], "panel").dropna()
    cuts = [0.0, *LEVELS.values()]
    bounds["state"] = pd.cut(100.0 * bounds.value, cuts, labels=list(LEVELS), include_lowest=True).astype(str)
    outliers = frame[f"{K}_gross"]
    cases = [frame.aliased.astype(bool), outliers > 0.5, outliers > RARE, near(frame)]
    state = np.select(cases, [ABOVE, MOSTLY, SOME, GOOD], FARTHER)
    panel = [load_method(name).card.title for name in frame.method]
    states = frame[names].assign(panel=panel, state=state)
    below = states[states.state != ABOVE]
    shares = (below.state == GOOD).groupby(below.panel, sort=False).mean().sort_values(ascending=False, kind="stable")
    parts = [
        _map(bounds.assign(panel=bounds.panel.map(BOUNDS)), axes, list(BOUNDS.values()), list(LEVELS), BLUES),
        _map(states, axes, list(shares.index), list(STATES), list(STATES.values())),
    ]
    return Picture(
        f"atlas_{plane.name}",
        alt.vconcat(*parts, spacing=6).resolve_scale(color="independent"),
        f"{shares.index[0]} is within {NEAR:g} times the bound on the largest part of this map, "
        f"{100 * shares.max():.0f} %. Above: the Cramér-Rao bounds, and the probability that the likelihood has its "
        "maximum at a wrong frequency. Below: error of k/m relative to the bound, one map per method. Above Nyquist "
        f"several frequencies fit the samples equally well. Each point has {int(frame.fits.max())} data sets, so "
        "neighbours differ by chance.",
    )


def _map(
    frame: pd.DataFrame, axes: tuple[Axis, Axis], panels: Sequence[str], states: Sequence[str], colours: Sequence[str]
) -> Any:
    """Draw rectangles coloured by state, whose edges are half way between the points, one panel per method."""
    frame, sides = frame.copy(), []
    for axis, kind, name in zip(axes, (alt.X, alt.Y), "xy", strict=True):
        log = axis.spacing == "logarithmic"
        values = np.sort(frame[axis.name].unique())
        middle = np.sqrt(values[1:] * values[:-1]) if log else (values[1:] + values[:-1]) / 2.0
        edges, place = np.array([values[0], *middle, values[-1]]), np.searchsorted(values, frame[axis.name])
        frame[name], frame[f"{name}2"] = edges[place], edges[place + 1]
        scale, ticks = logarithmic(edges[0], edges[-1]) if log else (alt.Scale(zero=False, nice=False), alt.Axis())
        sides.append(kind(f"{name}:Q").scale(scale).axis(ticks).title(AXES[axis.name]))
    hue = alt.Color("state:N").scale(domain=list(states), range=list(colours)).legend(columns=5)
    marks = alt.Chart(table(frame)).mark_rect(x2Offset=0.4, y2Offset=-0.4)
    chart = marks.encode(*sides, hue, x2="x2:Q", y2="y2:Q", tooltip=[*(axis.name for axis in axes), "state"])
    columns = len(panels) if len(panels) < 6 else 4
    facet = alt.Facet("panel:N").sort(list(panels))
    return chart.properties(width=330 / columns, height=76).facet(facet, columns=columns, spacing=6)
