"""Pictures of one record over time, and of a training: the paper's Figures 4 to 6, 9 and 11."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import altair as alt
import numpy as np
import pandas as pd

from bench.contract.problem import Channel, Record
from bench.dynamics.simulate import fitted_start, simulate
from bench.reporting.figures.gallery import Gallery, Nothing, Picture, counts, methods_only, named, where
from bench.reporting.frame import Result
from bench.reporting.labels import beside_paper, title
from bench.reporting.paper import own_method
from bench.reporting.pictures.style import ONE, in_lines, layered, panel_names, table
from bench.scoring.statistics import Z95

MILLI = 1000.0
POINTS = 200
"""Of a curve, drawn at most."""
SHOWN = 8
"""Reconstructions shown at most."""
DRAWS = 400
LOSS, EVALUATIONS, TERM = "trace_loss", "trace_evaluations", "trace_mean_square_"
TERMS = {"data": "data", "physics": "equation of motion", "initial": "initial state", "prior": "prior"}
TRUE, SAMPLES = "true response", "samples"
Arrays = Mapping[str, np.ndarray]


def with_record(gallery: Gallery, cells: list[Result]) -> list[tuple[Result, dict[str, np.ndarray]]]:
    """The cells whose record is stored, with the arrays."""
    found = [(one, gallery.arrays(one)) for one in cells]
    found = [(one, arrays) for one, arrays in found if "true_displacement" in arrays and "sample_values" in arrays]
    if not found:
        raise Nothing("no arrays of a record are stored")
    return found


def samples_of(arrays: Arrays, dof: int) -> tuple[np.ndarray, np.ndarray]:
    """Times (s) and values (m) of one DOF's samples in the first record."""
    own = arrays["sample_dof"] == dof
    return arrays["sample_times"][own], arrays["sample_values"][own]


def _curves(panel: str, times: np.ndarray, **curves: np.ndarray) -> pd.DataFrame:
    """Lines of a table: a panel, a time and the values of curves there."""
    every = max(1, -(-len(times) // POINTS))
    return pd.DataFrame({"panel": panel, "time": times, **curves})[::every]


def _points(panel: str, arrays: Arrays, dof: int) -> pd.DataFrame:
    """Lines of a table: a panel, and a DOF's samples."""
    times, values = samples_of(arrays, dof)
    return pd.DataFrame({"panel": panel, "time": times, SAMPLES: values})


def _line(chart: Any, column: str, **mark: Any) -> Any:
    """A curve of a table over time."""
    x, y = alt.X("time:Q").title(None), alt.Y(f"{column}:Q").title(None)
    return chart.transform_filter(f"isValid(datum['{column}'])").mark_line(**mark).encode(x, y)


def _samples(chart: Any) -> Any:
    """The samples of a table."""
    shown = chart.transform_filter(f"isValid(datum['{SAMPLES}'])").mark_point(size=9, strokeWidth=0.7, style="truth")
    return shown.encode(alt.X("time:Q").title(None), alt.Y(f"{SAMPLES}:Q").title(None))


def _panels(layers: Any, order: Sequence[str], columns: int, height: float, axes: str) -> Any:
    """Panels in order under one title of what is up and what is across."""
    facet = alt.Facet("panel:N").sort(list(order)).header(panel_names())
    drawn = layers.properties(width=100, height=height).facet(facet, columns=columns, spacing={"row": 8, "column": 10})
    return drawn.properties(title=alt.Title(axes, anchor="middle"))


def draw_record(gallery: Gallery) -> Picture:
    """The samples of one replicate and the true response, a panel for each DOF with a sensor."""
    cell, arrays = with_record(gallery, gallery.scene(gallery.main, "known"))[0]
    dofs = sorted(set(arrays["sample_dof"].tolist()))
    names = ["" if len(dofs) == 1 else f"mass {dof + 1}" for dof in dofs]
    parts = []
    for i, (dof, name) in enumerate(zip(dofs, names, strict=True)):
        sigma = cell.sigma[i] if i < len(cell.sigma) and cell.sigma[i] is not None else math.nan
        points = _points(name, arrays, dof)
        points = points.assign(low=points[SAMPLES] - sigma, high=points[SAMPLES] + sigma)
        parts += [_curves(name, arrays["dense_times"], true=arrays["true_displacement"][dof]), points]
    chart = alt.Chart(table(pd.concat(parts)))
    bars = chart.transform_filter("isValid(datum.low)").mark_rule(style="truth", strokeWidth=0.7)
    layers = layered(
        chart.data,
        _line(chart, "true", style="broad", strokeWidth=2.5),
        bars.encode(alt.X("time:Q").title(None), alt.Y("low:Q").title(None), y2="high:Q"),
        _samples(chart),
    )
    size = int(np.sum(arrays["sample_dof"] == dofs[0]))
    of = "the displacement" if len(dofs) == 1 else f"each of {len(dofs)} displacements"
    return Picture(
        _panels(layers, names, 1, 110, "displacement (m) over time (s)"),
        f"The methods are given {size} noisy samples of {of} over {cell.duration:g} s. The grey line is the true "
        f"response, which no method sees ({where(cell)}; replicate 0). The bars are the noise's standard "
        "deviation σ, which no method is told either. The noise level is the same over the whole record, so the "
        "decayed part tells less. The paper's Figure 4 shows the same.",
        half=True,
    )


def point_parameters(cell: Result) -> dict[str, float] | None:
    """The parameters that a method found in replicate 0, from its scores: ratio times truth; None where not all are."""
    true = cell.parameters
    values = {name: cell.first(f"{name}_ratio") * float(value) for name, value in true.items()}
    return values if all(np.isfinite(value) for value in values.values()) else None


def simulated(cell: Result, arrays: Arrays) -> np.ndarray | None:
    """The free response of the parameters found, (n_dof, n_dense): what is scored where a method reconstructs nothing.

    From the start that was told, or the one that fits the samples best. None with a force, which is not stored.
    """
    p = point_parameters(cell)
    if p is None or cell.forced or cell.added_mass:
        return None
    system = cell.model
    dofs = sorted(set(arrays["sample_dof"].tolist()))
    channels = tuple(Channel(*samples_of(arrays, dof), dof=dof) for dof in dofs)
    start = cell.start_told or fitted_start(system, p, Record(channels, (), None))
    return np.asarray(simulate(system, p, start, arrays["dense_times"]).displacement)


def draw_reconstruction(gallery: Gallery) -> Picture:
    """The displacement of the paper's own method and of those farthest from the true one; the first measured DOF."""
    drawn = list[tuple[Result, Arrays, np.ndarray]]()
    for cell, arrays in with_record(gallery, gallery.scene(gallery.main, "known")):
        own = arrays.get("displacement")
        curve = simulated(cell, arrays) if own is None else own
        if curve is not None and cell.label != "prior":
            drawn.append((cell, arrays, curve))
    if not drawn:
        raise Nothing("no reconstruction is stored")
    papers = beside_paper(own_method())[:1]
    drawn.sort(key=lambda one: (one[0].label not in papers, -np.nan_to_num(one[0].first("rmse"))))
    dof = int(drawn[0][1]["sample_dof"][0])
    parts, names = [], []
    for cell, kept, curve in drawn[:SHOWN]:
        rmse, stand_in = cell.first("rmse"), "displacement" not in kept
        text = f"\nRMSE {MILLI * rmse:.3g} mm" if np.isfinite(rmse) else ""
        names.append(in_lines(gallery.name(cell.label), 22) + text + (", simulated" if stand_in else ""))
        true = kept["true_displacement"][dof]
        parts.append(_curves(names[-1], kept["dense_times"], true=true, found=curve[dof]))
        parts.append(_points(names[-1], kept, dof))
    truth = drawn[0][1]["true_displacement"][dof]
    limits = alt.Scale(domain=[1.35 * min(truth.min(), -1e-12), 1.35 * max(truth.max(), 1e-12)], nice=False)
    chart = alt.Chart(table(pd.concat(parts)))
    layers = layered(
        chart.data,
        _line(chart, "true", style="broad", strokeWidth=2.5).encode(alt.Y("true:Q").scale(limits).title(None)),
        _line(chart, "found", clip=True),
        _samples(chart),
    )
    far = [gallery.name(c.label) for c, *_ in drawn if c.sigma and c.first("rmse") > c.sigma[0]]
    left = len(drawn) - SHOWN
    others = f" {left} methods that are closer are left out." if left > 0 else ""
    which = "" if len(drawn[0][1]["true_displacement"]) == 1 else f", DOF {dof + 1}"
    return Picture(
        _panels(layers, names, 4, 70, "displacement (m) over time (s)"),
        f"All methods follow the true response{f' except {named(far)}' if far else ''}. Each panel is what a method "
        f"makes of the same record ({where(drawn[0][0])}; replicate 0{which}): first the paper's own, then those "
        f"farthest from the truth.{others} Grey: the true response. Simulated: it has no reconstruction, and the "
        "response of its parameters stands in. The number is the root mean square error of this replicate over the "
        "whole record; the first sentence names those whose error is larger than the noise of a sample. A good "
        "method's line hides the true response; one with a wrong k/m runs ahead of it or behind, more with every "
        "cycle. The paper's Figure 5 shows this for its PINN alone.",
    )


def draw_band(gallery: Gallery) -> Picture:
    """The error of each reconstruction with its band: where the band holds zero, it holds the truth."""
    found = with_record(gallery, gallery.scene(gallery.main, "known"))
    found = [(cell, a) for cell, a in found if "displacement_sd" in a and "displacement" in a]
    if not found:
        raise Nothing("no band is stored")
    parts, names, shares = [], [], []
    for cell, arrays in found:
        inside = cell.successful("band_inside_95")
        share = f"\n{100 * inside.mean():.0f} % inside (n = {inside.size})" if inside.size else ""
        shares += [100.0 * float(inside.mean())] if inside.size else []
        names.append(in_lines(gallery.name(cell.label), 30) + share)
        dof = int(arrays["sample_dof"][0])
        error = MILLI * (arrays["displacement"][dof] - arrays["true_displacement"][dof])
        half = MILLI * Z95 * arrays["displacement_sd"][dof]
        parts.append(_curves(names[-1], arrays["dense_times"], error=error, low=error - half, high=error + half))
    layers = _with_band(table(pd.concat(parts)))
    chart = _panels(layers, names, 3, 90, "estimate − truth (mm) over time (s)").resolve_scale(y="independent")
    cells = [cell for cell, _ in found]
    low, high = (f"{edge:.0f}" for edge in (min(shares, default=0.0), max(shares, default=0.0)))
    lead = f"95 % bands hold the truth over {low if low == high else f'{low} to {high}'} % of the record."
    return Picture(
        chart,
        f"{lead if shares else 'A band says how far a reconstruction may be off.'} Each panel is a method that "
        f"states a band ({where(cells[0])}; replicate 0): its reconstruction minus the true response, and 1.96 of "
        "its standard deviations to either side. Where the band holds the line at zero it holds the truth. The "
        "percentage is measured: the mean share of the record inside the method's own 95 % band over "
        f"{counts(cells)} replicates; 95 is what a band should have. Scales differ from panel to panel. The bands "
        "breathe with the motion: parameters that are a little wrong move the response most where it is fast or "
        "far out. The paper's Figure 9 draws such a band without saying how often it holds.",
    )


def _with_band(frame: pd.DataFrame) -> Any:
    """An error over time with its band and the line at zero."""
    chart = alt.Chart(frame)
    x, low = alt.X("time:Q").title(None), alt.Y("low:Q").title(None)
    return layered(
        frame,
        chart.transform_filter("isValid(datum.low)").mark_area(opacity=0.3).encode(x, low, y2="high:Q"),
        alt.Chart(ONE).mark_rule(style="truth").encode(y=alt.datum(0)),
        _line(chart, "error"),
    )


def draw_two_masses(gallery: Gallery) -> Picture:
    """Response of every DOF, identified and true, and beside it the error with its band."""
    cells = gallery.largest(one for one in gallery.cells if one.n_dof > 1)
    found = [
        (c, a) for c, a in with_record(gallery, methods_only(gallery.scene(cells, "known"))) if "displacement" in a
    ]
    if not found:
        raise Nothing("no reconstruction of a system of two masses or more is stored")
    first = beside_paper(own_method())  # the paper's own, else the first of all
    cell, arrays = next((pair for label in first for pair in found if pair[0].label == label), found[0])
    sd, source = band(cell, arrays)
    off = arrays["displacement"] - arrays["true_displacement"]
    times, rows = arrays["dense_times"], []
    half = np.full_like(off, math.nan) if sd is None else Z95 * sd
    for dof, error in enumerate(off):
        frame = pd.concat([
            _curves("response (m)", times, true=arrays["true_displacement"][dof], found=arrays["displacement"][dof]),
            _points("response (m)", arrays, dof),
            _curves("error (mm)", times, error=MILLI * error, low=MILLI * (error - half[dof]),
                    high=MILLI * (error + half[dof])),
        ])  # fmt: skip
        frame = table(frame.assign(mass=f"mass {dof + 1}"))
        left, right = (frame[frame.panel == panel] for panel in ("response (m)", "error (mm)"))
        chart = alt.Chart(left)
        response = layered(
            left, _line(chart, "true", style="broad", strokeWidth=2.5), _line(chart, "found"), _samples(chart)
        )
        pair = ((response, "response"), (_with_band(right), "error"))
        units = {"response": "m", "error": "mm"}
        rows.append(alt.hconcat(*(
            own.properties(width=150, height=80, title=alt.Title(
                f"{name} of mass {dof + 1} ({units[name]}) over time (s)", orient="top", anchor="start"))
            for own, name in pair
        )))  # fmt: skip
    inside = ""
    if sd is not None:
        inside = f" In this replicate it holds {100 * np.mean(np.abs(off) <= half):.0f} % of the true responses."
    return Picture(
        alt.vconcat(*rows),
        f"{title(cell.label)} finds the motion of {len(off)} masses to {MILLI * math.sqrt(np.mean(off**2)):.2g} mm, "
        f"root mean square. Left: response, grey the true one, with the samples ({where(cell)}; replicate 0). Right: "
        f"estimate minus truth.{source}{inside} Where the band holds the line at zero it holds the truth. The paper's "
        "Figure 11 shows a simulated response of two masses, of which nothing is identified.",
    )


def band(cell: Result, arrays: Arrays) -> tuple[np.ndarray | None, str]:
    """Standard deviation (n_dof, n_dense) of the displacement, and in words where it is from.

    The method's own, or the spread of responses to draws of its stated normal belief or to its own draws, where the
    start was told and no force acts.
    """
    if "displacement_sd" in arrays:
        return arrays["displacement_sd"], " The band is the method's own, 1.96 standard deviations to either side."
    draws = belief_draws(cell, arrays)
    start = cell.start_told
    if draws is None or start is None or cell.forced:
        return None, " The method states no band."
    system = cell.model
    p = dict(zip(system.names, draws.T, strict=True))
    x0, v0 = (np.repeat(part[:, None], len(draws), 1) for part in (start.displacement, start.velocity))
    paths = simulate(system, p, (x0, v0), arrays["dense_times"]).displacement
    return np.nanstd(paths, axis=1), " The band is the spread of the responses to the method's stated parameters."


def belief_draws(cell: Result, arrays: Arrays) -> np.ndarray | None:
    """Draws (n, n_parameters) of a stored belief over all parameters in the system's order; None where it is another.

    A stored mean does not say whether it is of logarithms, nor in which order: it is taken if it gives the parameters
    that were scored.
    """
    p = point_parameters(cell)
    if p is None:
        return None
    values = np.array([p[name] for name in cell.model.names])
    if "draws" in arrays:
        own = arrays["draws"]
        close = own.shape[1] == values.size and np.all(np.abs(np.log(np.median(own, 0) / values)) < 0.5)
        return own if close else None
    if "covariance" not in arrays or arrays["mean"].shape != values.shape:
        return None
    if not np.allclose(np.exp(arrays["mean"]), values, rtol=1e-3):
        return None
    normal = np.random.default_rng(0).multivariate_normal(arrays["mean"], arrays["covariance"], DRAWS, method="svd")
    return np.exp(normal)


def draw_training(gallery: Gallery) -> Picture:
    """The loss and the mean square of each of its terms over evaluations, one line a method."""
    found = [(cell, gallery.arrays(cell)) for cell in gallery.scene(gallery.main, "known")]
    found = [(cell, arrays) for cell, arrays in found if LOSS in arrays and EVALUATIONS in arrays]
    if not found:
        raise Nothing("no history of a loss is stored")
    stored = {name for _, a in found for name in a if name.startswith(TERM) and np.any(a[name] > 0)}
    known = [f"{TERM}{term}" for term in TERMS]
    order = [LOSS, *(name for name in [*known, *sorted(stored - set(known))] if name in stored)]
    terms = [name.removeprefix(TERM) for name in order]
    names = ["whole loss", *(in_lines(TERMS.get(term, term.replace("_", " ")), 30) for term in terms[1:])]
    parts = [
        _history(gallery.name(cell.label), panel, arrays[EVALUATIONS], arrays[name])
        for cell, arrays in found
        for name, panel in zip(order, names, strict=True)
        if name in arrays
    ]
    methods = [gallery.name(cell.label) for cell, _ in found]
    frame = table(pd.concat(parts))
    log = alt.Scale(type="log", nice=False)
    layers = alt.Chart(frame).mark_line().encode(
        alt.X("evaluations:Q").scale(log).title(None).axis(format="~s", tickCount=4, grid=False),
        alt.Y("value:Q").scale(log).title(None).axis(format="~g", tickCount=5, grid=False),
        alt.Color("method:N").sort(methods).legend(columns=3),
        tooltip=["method", "evaluations", "value"],
    )  # fmt: skip
    chart = _panels(layers, names, 3, 90, "loss, mean square (−) over evaluations of all residuals (−)")
    last = {gallery.name(cell.label): (a[EVALUATIONS].max(), a[LOSS][-1]) for cell, a in found}
    ends = ", ".join(f"{name} {evaluations:.0f} (loss {loss:.3g})" for name, (evaluations, loss) in last.items())
    soonest, latest = (least(last, key=lambda name: last[name][0]) for least in (min, max))
    lead = f"{soonest} ends its training after {last[soonest][0]:.0f} evaluations"
    lead += f", {latest} after {last[latest][0]:.0f}" if latest != soonest else ""
    same = [label for label in beside_paper(own_method()) if label in {cell.label for cell, _ in found}]
    both = (
        f" The {title(same[0])}'s two trainings minimise the same loss of the same network." if len(same) == 2 else ""
    )
    return Picture(
        chart.resolve_scale(y="independent"),
        f"{lead}. On the same record ({where(found[0][0])}; replicate 0): the whole loss, each term with the "
        "weight it has at the end (which can lift the curve before), and the mean square of each term, in natural "
        f"units. Evaluations until the end, and the loss there: {ends}.{both} A line "
        "ends where its training stopped, which need not be at the minimum. A term that is nil throughout is left "
        "out, and a line begins late where a term is nil at first. The paper's Figure 6 shows the whole loss "
        "alone.",
    )


def _history(method: str, panel: str, evaluations: np.ndarray, values: np.ndarray) -> pd.DataFrame:
    """A loss over evaluations, at points that are about evenly spaced on a logarithmic axis."""
    order = np.argsort(evaluations, kind="stable")
    evaluations, values = np.maximum(evaluations[order], 1.0), values[order]
    kept = np.unique(np.searchsorted(evaluations, np.geomspace(evaluations[0], evaluations[-1], POINTS)))
    kept = kept[values[kept] > 0]
    return pd.DataFrame({"method": method, "panel": panel, "evaluations": evaluations[kept], "value": values[kept]})
