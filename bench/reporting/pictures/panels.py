"""Pictures with a panel a method or a quantity: estimates about the truth, coverage of intervals, error and noise."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

import altair as alt
import numpy as np
import pandas as pd
from scipy.stats import binom

from bench.reporting.figures.gallery import Gallery, Nothing, Picture, best_first, counts, named, where
from bench.reporting.frame import Result
from bench.reporting.labels import beside_paper, cards, title
from bench.reporting.paper import own_method, printed
from bench.reporting.pictures.style import ONE, in_lines, layered, panel_names, plain, table
from bench.reporting.tables.estimates import FEWEST

LEVEL = 5.991
"""The 95 % quantile of chi-squared with two degrees of freedom."""
REACH = 4.5
"""Half the width of a panel of estimates, in standard deviations of the bound."""
BESIDE = 1.5
"""A cloud is beside the truth whose median k/m is off by so many median deviations from it."""
K, C = "k_over_m", "c_over_m"
NOMINAL = np.unique([0.01, *np.arange(3, 100, 3) / 100.0, 0.5, 0.8, 0.95])
BAND_LEVELS = (50, 80, 95)
METRICS = {"k_over_m_error_pct": "k/m (%)", "c_over_m_error_pct": "c/m (%)", "rmse": "displacement (mm)"}
MILLI = 1000.0
PAPER_SYSTEM = {"m": 1.0, "c": 0.4, "k": 8.0}
COLUMNS = 5


def _method_panels(layers: Any, methods: Sequence[str], height: float) -> Any:
    """A panel a method, in order."""
    facet = alt.Facet("method:N").sort(list(methods)).header(panel_names(labelLimit=84))
    columns = min(COLUMNS, len(methods))
    return layers.properties(width=80, height=height).facet(facet, columns=columns, spacing={"row": 6, "column": 8})


def bound_covariance(cell: Result) -> np.ndarray | None:
    """The bound on the covariance of (log k/m, log c/m), (2, 2); None where the cell's bounds do not tell it.

    All is in the stored bounds: with ``ζ = (c/m) / 2 (k/m)^(1/2)``, ``var log ζ = var log c/m + var log k/m / 4 -
    cov(log k/m, log c/m)``.
    """
    k, c, zeta = (cell.bound(f"{name}_error_pct") / 100.0 for name in (K, C, "damping_ratio"))
    if not all(map(math.isfinite, (k, c, zeta))):
        return None
    cross = c**2 + k**2 / 4.0 - zeta**2
    return np.array([[k**2, cross], [cross, c**2]])


def ellipse(covariance: np.ndarray, points: int = 61) -> np.ndarray:
    """Errors (%) on the 95 % ellipse of a normal pair of logarithms around no error, shape (2, points)."""
    angle = np.linspace(0.0, 2.0 * np.pi, points)
    circle = np.sqrt(LEVEL) * np.stack([np.cos(angle), np.sin(angle)])
    return np.asarray(100.0 * np.expm1(np.linalg.cholesky(covariance + 1e-18 * np.eye(2)) @ circle))


def draw_scatter(gallery: Gallery) -> Picture:
    """One panel a method: every replicate's errors of both groups, and the bound's 95 % ellipse."""
    cells = [c for c in gallery.scene(gallery.main, "known") if c.label != "prior"]
    cells = [c for c in cells if c.successful(f"{K}_ratio").size and c.successful(f"{C}_ratio").size]
    if not cells:
        raise Nothing("no estimates of k/m and c/m are stored")
    covariance = bound_covariance(cells[0])
    errors = [100.0 * (np.stack([c.successful(f"{n}_ratio") for n in (K, C)]) - 1.0) for c in cells]
    spreads = [np.median(np.abs(own), axis=1) for own in errors]
    k, c = 5.0 * np.maximum(np.median(spreads, axis=0), 1e-4)
    if covariance is not None:
        k, c = 100.0 * REACH * np.sqrt(np.diag(covariance))
    outside = [(abs(own[0]) > k) | (abs(own[1]) > c) for own in errors]
    names = [
        in_lines(gallery.name(cell.label), 18) + (f"\n{own.sum()} outside" if own.any() else "")
        for cell, own in zip(cells, outside, strict=True)
    ]
    frame = pd.DataFrame(np.concatenate(errors, axis=1).T, columns=["k/m", "c/m"])
    frame["method"] = np.repeat(names, [own.shape[1] for own in errors])
    frame["place"] = np.where(np.concatenate(outside), "beyond the edge", "on the panel")
    x, y = (
        alt.X("k/m:Q").scale(domain=[-k, k], clamp=True, nice=False).title(None).axis(tickCount=3),
        alt.Y("c/m:Q").scale(domain=[-c, c], clamp=True, nice=False).title(None).axis(tickCount=3),
    )
    chart = alt.Chart(table(frame))
    points = chart.mark_point(filled=True, size=9, opacity=0.7).encode(
        x, y, alt.Color("place:N").sort("descending"), tooltip=["method", "k/m", "c/m"]
    )
    layers = [
        points,
        alt.Chart(ONE)
        .mark_point(shape="cross", filled=True, size=20, style="truth")
        .encode(x=alt.datum(0), y=alt.datum(0)),
    ]
    if covariance is not None:
        region = pd.DataFrame(ellipse(covariance).T, columns=["k/m", "c/m"]).assign(order=range(61))
        layers[:0] = [alt.Chart(table(region)).mark_line(style="region", filled=True).encode(x, y, order="order:Q")]
    panels = _method_panels(layered(chart.data, *layers), names, 72)
    whole = panels.properties(title=alt.Title("error of c/m (%) over error of k/m (%)", anchor="middle"))
    region_text = (
        "The ellipse is the Cramér-Rao bound's: 95 % of the estimates of an unbiased method that reaches it lie in it "
        "(its correlation follows from the stored bounds of k/m, c/m and damping ratio). "
    )
    beside = [gallery.name(cell.label) for cell, own in zip(cells, errors, strict=True) if _is_beside(own[0])]
    return Picture(
        whole,
        f"All methods scatter around the truth{f' except {named(beside)}' if beside else ''}. One point is a replicate"
        f": its errors of both identifiable groups ({where(cells[0])}; {counts(cells)} a method). "
        f"{region_text if covariance is not None else ''}The cross is the truth. Estimates beyond a panel's edge stand "
        "on it, and are counted. Methods on the bound fill the ellipse and nothing else; a cloud beside it is a bias, "
        "a wider one is information lost. Beside the truth counts a cloud whose median k/m is off by more than "
        f"{BESIDE:g} median deviations. The paper's Figure 7 shows one estimate of each group.",
    )


def _is_beside(errors: np.ndarray) -> bool:
    """Whether the middle of errors (n,) is off by more than their own spread."""
    middle = float(np.median(errors))
    return abs(middle) > BESIDE * float(np.median(np.abs(errors - middle)))


def covered(levels: np.ndarray, nominal: np.ndarray) -> np.ndarray:
    """Share of replicates whose equal-tailed interval of each nominal level holds the truth, shape of ``nominal``.

    ``levels`` (n,) are the belief's levels at the truth: an interval of level v holds it where they are within v/2 of
    a half.
    """
    return np.asarray(np.mean(np.abs(levels - 0.5)[:, None] <= nominal / 2.0 + 1e-12, axis=0))


def _most_replicates(gallery: Gallery) -> list[Result]:
    """The main scenario under the seed with most levels: calibration is tested on one of its own."""

    def alike(cell: Result) -> str:
        return json.dumps({**json.loads(cell.series), "seed": 0}, sort_keys=True)

    wanted = alike(gallery.main[0])
    by_seed: dict[int, list[Result]] = {}
    for cell in gallery.cells:
        if alike(cell) == wanted:
            by_seed.setdefault(cell.seed, []).append(cell)
    scenes = {seed: gallery.scene(own, "unknown") for seed, own in by_seed.items()}
    return max(scenes.values(), key=lambda own: (sum(c.successful(f"{K}_pit").size for c in own), -own[0].seed))


def draw_coverage(gallery: Gallery) -> Picture:
    """One panel a method: measured against nominal level of the intervals of k/m, c/m and the displacement's band."""
    cells = [c for c in _most_replicates(gallery) if c.label != "prior" and c.successful(f"{K}_pit").size >= FEWEST]
    if not cells:
        raise Nothing(f"no method with intervals of k/m over {FEWEST} replicates or more is stored")
    frame = pd.concat([_coverage(gallery, cell) for cell in cells])
    quantities = [name for name in ("k/m", "c/m", "band of the displacement") if frame[name].notna().any()]
    chart = alt.Chart(table(frame))
    apart = chart.transform_fold([*quantities], as_=["quantity", "share"]).transform_filter("isValid(datum.share)")
    ticks = alt.Axis(values=[0, 50, 95])
    x = alt.X("level:Q").scale(domain=[0, 100], nice=False).axis(ticks).title(None)
    y = alt.Y("share:Q").scale(domain=[0, 100], nice=False).axis(ticks).title(None)
    hue = alt.Color("quantity:N").sort(quantities)
    layers = layered(
        chart.data,
        chart.mark_area(style="region", strokeWidth=0).encode(x, alt.Y("low:Q").title(None).axis(ticks), y2="high:Q"),
        chart.mark_line(style="quiet", strokeWidth=0.6).encode(x, alt.Y("level:Q").title(None).axis(ticks)),
        apart.transform_filter("datum.quantity != 'band of the displacement'").mark_line().encode(
            x, y, hue, tooltip=["method", "quantity:N", "level", "share:Q"]
        ),
        apart.transform_filter("datum.quantity == 'band of the displacement'").mark_point(
            filled=True, size=14, opacity=1).encode(x, y, hue, tooltip=["method", "quantity:N", "level", "share:Q"]),
    )  # fmt: skip
    panels = _method_panels(layers, list(dict.fromkeys(frame.method)), 80)
    axes = "replicates whose interval holds the truth (%) over its nominal level (%)"
    held = [_holds(cell) for cell in cells if not cell.is_reference]
    band = " Points: mean share of the record inside the displacement's band." if len(quantities) > 2 else ""
    return Picture(
        panels.properties(title=alt.Title(axes, anchor="middle")),
        f"The 95 % intervals of k/m hold the truth as often as they say in {sum(held)} of {len(held)} methods. For "
        f"each level, how often the interval of k/m and of c/m held the truth ({where(cells[0])}, seed "
        f"{cells[0].seed}; {counts(cells)} replicates).{band} On the diagonal a statement is right; below it a method "
        "is too sure of itself, above it too modest. In the grey band a calibrated method is with 95 % probability at "
        "each level, given so many replicates; over all levels it may leave the band here and there by chance. The "
        "tables say in numbers which methods are not calibrated.",
    )


def _coverage(gallery: Gallery, cell: Result) -> pd.DataFrame:
    """Of each nominal level (%): measured levels, and the range of a calibrated method's."""
    k, c = (cell.successful(f"{name}_pit") for name in (K, C))
    low, high = (100.0 * binom.ppf(tail, k.size, NOMINAL) / k.size for tail in (0.025, 0.975))
    name = f"{in_lines(gallery.name(cell.label), 18)}\nn = {k.size}"
    columns = {"method": name, "level": 100.0 * NOMINAL, "low": low, "high": high, "k/m": 100.0 * covered(k, NOMINAL)}
    columns["c/m"] = 100.0 * covered(c, NOMINAL) if c.size else math.nan
    inside = {level: own.mean() for level in BAND_LEVELS if (own := cell.successful(f"band_inside_{level}")).size}
    columns["band of the displacement"] = [100.0 * inside.get(round(100.0 * level), math.nan) for level in NOMINAL]
    return pd.DataFrame(columns)


def _holds(cell: Result) -> bool:
    """Whether the 95 % interval of k/m held the truth as often as that of a calibrated method, up to chance."""
    levels = cell.successful(f"{K}_pit")
    low, high = binom.ppf([0.025, 0.975], levels.size, 0.95) / levels.size
    return bool(low <= covered(levels, np.array([0.95]))[0] <= high)


def draw_noise(gallery: Gallery) -> Picture:
    """A panel a quantity: error over noise of every method, in colour those of the paper, and the bound."""
    cells = [cell for cell in gallery.main if cell.initial_state == "known"] or gallery.main
    cells = [cell for cell in cells if cell.label != "prior"]
    rows = [
        (gallery.name(c.label), c.label, c.snr_db, name, c.excess(metric) * c.bound(metric), c.bound(metric))
        for c in cells
        for metric, name in METRICS.items()
    ]
    found = pd.DataFrame(rows, columns=["method", "label", "SNR", "quantity", "error", "bound"]).dropna()
    found.loc[found.quantity == METRICS["rmse"], ["error", "bound"]] *= MILLI
    found = found[found.error > 0]
    if found.empty:
        raise Nothing("no method with an error and a bound is stored")
    papers = [
        label for label in gallery.looks if (card := cards().get(label)) and card.paper and label in set(found.label)
    ]
    printed_name = ""
    if cells[0].parameters == PAPER_SYSTEM and cells[0].kind == "sdof" and (own := beside_paper(own_method())):
        printed_name = f"{title(own[0])} in the paper"
        points = [(p.snr_db, MILLI * p.value) for p in printed() if p.table == 5 and p.metric == "rmse"]
        theirs = pd.DataFrame(points, columns=["SNR", "error"]).assign(method=printed_name, quantity=METRICS["rmse"])
        found = pd.concat([found, theirs])
    found["series"] = np.where(found.label.isin(papers) | (found.method == printed_name), found.method, "others")
    series = [*(gallery.name(label) for label in papers), *([printed_name] if printed_name else [])]
    chart = alt.Chart(table(found.drop(columns="label"))).encode(tooltip=["method", "SNR", "error", "bound"])
    x = alt.X("SNR:Q").scale(reverse=True, zero=False, padding=6).axis(values=sorted(set(found.SNR))).title(None)
    low, high = 0.7 * found[["error", "bound"]].min().min(), 1.4 * found.error.max()
    log = alt.Scale(type="log", domain=[low, high], nice=False)
    y = alt.Y("error:Q").scale(log).axis(values=plain(low, high), format="~g").title(None)
    hue = alt.Color("series:N").sort(series).legend(columns=4)
    told = chart.transform_filter("datum.series != 'others' && isValid(datum.bound)")
    layers = layered(
        chart.data,
        chart.mark_line(style="broad").encode(x, alt.Y("mean(bound):Q").scale(log)),
        chart.transform_filter("datum.series == 'others'")
        .mark_line(style="quiet", strokeWidth=0.5).encode(x, y, detail="method:N"),
        told.mark_line(point={"size": 12}).encode(x, y, hue),
        chart.transform_filter("!isValid(datum.bound)")
        .mark_point(shape="diamond", size=26, filled=False).encode(x, y, hue),
    ).properties(width=120, height=150)  # fmt: skip
    whole = layers.facet(column=alt.Column("quantity:N").sort(list(METRICS.values())), spacing=12)
    whole = whole.properties(title=alt.Title("error over signal-to-noise ratio (dB)", anchor="middle"))
    excesses = {label: (own.error / own.bound).tolist() for label, own in found.groupby("label", sort=False)}
    best = best_first({label: own for label, own in excesses.items() if label != "oracle"})
    worst = [max(excesses[label]) for label in best]
    diamonds = f" Diamonds: {printed_name} (its Table 5, Figure 10)." if printed_name else ""
    return Picture(
        whole,
        f"{sum(own <= 2.0 for own in worst)} of {len(best)} methods stay within twice the bound at every noise level. "
        f"Root mean square errors over the replicates ({cells[0].system}, initial state {cells[0].initial_state}; "
        f"{counts(cells)} replicates a point), failures left out; the least noise is on the left. In colour: the "
        "methods of the paper; grey, thin: all others. The broad grey line is the Cramér-Rao bound, the least error "
        "of an unbiased method; a biased one can be below it where the noise is large. A line that runs level has an "
        f"error of its own that no better sensor removes.{diamonds}",
    )
