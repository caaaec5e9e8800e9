"""Pictures of lines on logarithmic axes: error over noise, a training, profile likelihoods, cost over size."""

from __future__ import annotations

import math
from collections.abc import Sequence

import altair as alt
import numpy as np
import pandas as pd

from bench.contract.prior import Prior
from bench.information.profile import THRESHOLD, Profile
from bench.reporting.labels import cards, counterparts, title
from bench.reporting.paper import own_method, printed
from bench.reporting.pictures.gallery import METRICS, MOTION, C, Gallery, K, replicates, where
from bench.reporting.pictures.style import Nothing, Picture, layered, logarithmic, table

MILLI = 1000.0
QUANTITIES = {K: "k/m (%)", C: "c/m (%)", MOTION: "displacement (mm)"}
PAPER_SYSTEM = {"m": 1.0, "c": 0.4, "k": 8.0}
OTHERS, BOUND, DATA, PRIOR = "other methods", "Cramér-Rao bound", "data: profile likelihood", "prior"
LOSS, EVALUATIONS, TERM = "trace_loss", "trace_evaluations", "trace_mean_square_"
TERMS = {LOSS: "whole loss", f"{TERM}data": "mean square of the data", f"{TERM}physics": "of the equation of motion"}
POINTS = 100
"""Of a curve, drawn at most."""


def log_log(x: alt.X, y: alt.Y, across: pd.Series, up: pd.Series) -> tuple[alt.X, alt.Y]:
    """Return logarithmic axes around the values of two columns."""
    axes = [logarithmic(0.8 * values[values > 0].min(), 1.25 * values.max()) for values in (across, up)]
    return x.scale(axes[0][0]).axis(axes[0][1]), y.scale(axes[1][0]).axis(axes[1][1])


def draw_noise(gallery: Gallery) -> Picture:
    """Draw the error of every method over the noise level, those of the paper in colour, and the bound."""
    cells = [cell for cell in gallery.main if cell.initial_state == "known"] or gallery.main
    cells = [cell for cell in cells if cell.label != "prior"]
    errors = pd.DataFrame(
        [
            (
                title(c.label),
                c.label,
                c.snr_db,
                QUANTITIES[name],
                scale * c.excess(METRICS[name]) * bound,
                scale * bound,
            )
            for c in cells
            for name, scale in ((K, 1.0), (C, 1.0), (MOTION, MILLI))
            for bound in [c.bound(METRICS[name])]
        ],
        columns=["method", "label", "SNR", "quantity", "error", "bound"],
    ).dropna()
    errors = errors[errors.error > 0]
    if errors.empty:
        raise Nothing("no method with an error and a bound is stored")
    excess = (errors.error / errors.bound)[errors.label != "oracle"].groupby(errors.method).max()
    papers = [label for label, card in cards().items() if card.paper and label in set(errors.label)]
    published, diamonds = f"{title(own_method())} in the paper", ""
    if cells[0].parameters == PAPER_SYSTEM and cells[0].kind == "sdof" and own_method() in papers:
        numbers = [(published, published, p.snr_db, QUANTITIES[MOTION], MILLI * p.value) for p in printed()
                   if p.table == 5 and p.metric == "rmse"]  # fmt: skip
        errors = pd.concat([errors, pd.DataFrame(numbers, columns=errors.columns[:-1])])
        diamonds = f" Diamonds: {published} (its Table 5, Figure 10)."
    series = {label: title(label) for label in papers} | {published: published}
    errors["series"] = errors.label.map(series).fillna(OTHERS)
    chart = alt.Chart(table(errors.drop(columns="label"))).encode(tooltip=["method", "SNR", "error", "bound"])
    scale, axis = logarithmic(0.7 * errors[["error", "bound"]].min().min(), 1.4 * errors.error.max())
    x = alt.X("SNR:Q").scale(reverse=True, zero=False, padding=6).axis(values=sorted(set(errors.SNR))).title("SNR (dB)")
    name = "root mean square error"
    y = alt.Y("error:Q").scale(scale).axis(axis).title(name)
    named = [name for name in series.values() if name in set(errors.series)]
    hue = alt.Color("series:N").sort(named).legend(alt.Legend(columns=3) if named else None)
    drawn = chart.transform_filter(f"datum.series != '{OTHERS}'")
    layers = layered(
        chart.data,
        alt.Chart(chart.data).transform_filter("isValid(datum.bound)")
        .mark_line(style="broad", strokeWidth=6).encode(x, alt.Y("mean(bound):Q").scale(scale).title(name)),
        chart.transform_filter(f"datum.series == '{OTHERS}'")
        .mark_line(style="quiet", strokeWidth=0.5).encode(x, y, detail="method:N"),
        drawn.transform_filter("isValid(datum.bound)").mark_line(point={"size": 12}).encode(x, y, hue),
        drawn.transform_filter("!isValid(datum.bound)")
        .mark_point(shape="diamond", size=26, filled=False).encode(x, y, hue),
    ).properties(width=120, height=150)  # fmt: skip
    return Picture(
        "error_against_noise",
        layers.facet(column=alt.Column("quantity:N").sort(list(QUANTITIES.values())), spacing=10),
        f"{(excess <= 2.0).sum()} of {len(excess)} methods stay within twice the bound at every noise level. Root mean "
        f"square errors of the successful fits ({cells[0].system}, initial state {cells[0].initial_state}; "
        f"{replicates(cells)} per point). In colour the methods of the paper, thin and grey all others; the broad line "
        "is the Cramér-Rao bound, the smallest error of an unbiased method. A horizontal line is a bias, which less "
        f"noise does not remove.{diamonds}",
    )


def draw_training(gallery: Gallery) -> Picture:
    """Draw the loss and the mean square of two of its terms over evaluations, one line per method."""
    recorded = gallery.recorded(gallery.scene(gallery.main), LOSS, EVALUATIONS)
    parts = [
        training_curve(title(cell.label), panel, arrays[EVALUATIONS], arrays[name])
        for name, panel in TERMS.items() for cell, arrays in recorded if name in arrays
    ]  # fmt: skip
    frame = table(pd.concat(parts))
    x, y = alt.X("evaluations:Q").title("evaluations of all residuals"), alt.Y("value:Q").title("loss (−)")
    hue = alt.Color("method:N").sort([title(cell.label) for cell, _ in recorded]).legend(columns=3)
    chart = alt.Chart(frame).mark_line().encode(*log_log(x, y, frame.evaluations, frame.value), hue, tooltip=["value"])
    facet = alt.Column("term:N").sort(list(TERMS.values()))
    last = {title(cell.label): (a[EVALUATIONS].max(), a[LOSS][-1]) for cell, a in recorded}
    ends = ", ".join(f"{name} {n:.0f} (loss {loss:.3g})" for name, (n, loss) in last.items())
    soonest, latest = (choose(last, key=lambda name: last[name][0]) for choose in (min, max))
    lead = f"{soonest} ends its training after {last[soonest][0]:.0f} evaluations"
    lead += f", {latest} after {last[latest][0]:.0f}" if latest != soonest else ""
    same = " and ".join(title(cell.label) for cell, _ in recorded if cell.label in counterparts(own_method()))
    return Picture(
        "training_loss",
        chart.properties(width=120, height=110).facet(column=facet, spacing=8),
        f"{lead}. On the same record ({where(recorded[0][0])}; replicate 0): the whole loss, each term with its final "
        f"weight, and the mean square of two terms, in natural units. Final values: {ends}. {same} minimise the same "
        "loss of the same network. The paper's Figure 6 shows the whole loss alone.",
    )


def training_curve(method: str, term: str, evaluations: np.ndarray, values: np.ndarray) -> pd.DataFrame:
    """Return a loss over evaluations, at points about evenly spaced on a logarithmic axis."""
    order = np.argsort(evaluations, kind="stable")
    evaluations, values = np.maximum(evaluations[order], 1.0), values[order]
    kept = np.unique(np.searchsorted(evaluations, np.geomspace(evaluations[0], evaluations[-1], POINTS)))
    kept = kept[values[kept] > 0]
    return pd.DataFrame({"method": method, "term": term, "evaluations": evaluations[kept], "value": values[kept]})


def draw_profiles(name: str, profiles: Sequence[Profile], truth: dict[str, float], prior: Prior | None) -> Picture:
    """Draw profile likelihood, prior, threshold of the 95 % interval, and true value, one panel per quantity."""
    parts = []
    for profile in profiles:
        q, ends = profile.quantity, (profile.values[0], profile.values[-1])
        panel = q.name.replace("_over_", "/") + (f" ({q.unit})" if q.unit != "-" else "")
        curves = {DATA: (profile.values, profile.drop)}
        if prior is not None:
            w, sizes = np.array(q.vector(prior.names)), np.geomspace(*ends, 400)
            off = (np.log(sizes) - math.log(q.coefficient) - w @ prior.log_mean) / np.linalg.norm(w * prior.log_sds)
            curves[PRIOR] = (sizes, off**2 / 2)
        for curve, (values, drop) in curves.items():
            points = pd.DataFrame({"panel": panel, "curve": curve, "value": values, "fall": drop})
            parts.append(points.assign(true=q.value(truth), threshold=THRESHOLD))
    frame = table(pd.concat(parts).query(f"fall <= {3.0 * THRESHOLD}"))
    chart, x = alt.Chart(frame), alt.X("value:Q").scale(zero=False, nice=False).axis(tickCount=4).title(None)
    name_up, hue = "fall of log-likelihood (−)", alt.Color("curve:N").sort([DATA, PRIOR])
    fall = alt.Y("fall:Q").title(name_up)
    layers = layered(
        frame,
        chart.mark_rule(style="quiet", strokeDash=[4, 2]).encode(alt.Y("mean(threshold):Q").title(name_up)),
        chart.mark_rule(style="truth", strokeDash=[1, 2]).encode(alt.X("mean(true):Q").title(None)),
        chart.mark_line().encode(x, fall, hue),
        chart.transform_filter(f"datum.curve == '{DATA}'").mark_point(filled=True, size=8).encode(x, fall, hue),
    ).properties(width=100, height=80)
    facet = alt.Facet("panel:N").sort(list(dict.fromkeys(frame.panel)))
    return Picture(
        f"profile_{name}",
        layers.facet(facet, columns=min(4, len(profiles)), spacing=8).resolve_scale(x="independent"),
        "A quantity is identifiable if its curve rises on both sides of the minimum. Profile likelihoods on "
        "one replicate: each quantity is held and the rest fitted again, the noise level too, without a prior. Orange: "
        "half the squared distance from the prior's nominal value, in its standard deviations. Dashed: where a 95 % "
        "interval ends. Dotted: the true value.",
    )
