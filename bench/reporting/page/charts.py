"""Interactive charts of the site as Vega-Lite specifications.

Colours are set by ``static/site.js``; marks that are not a series have the named style ``ink``, ``quiet`` or
``region``.
"""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
import pandas as pd

from bench.errors import InputError
from bench.reporting.frame import ERROR, Result
from bench.reporting.labels import title
from bench.reporting.page.reading import ScenarioPanel
from bench.reporting.page.words import quantity
from bench.reporting.pictures.responses import samples_of, simulated
from bench.reporting.ranking import fits_of

POINTS = 42
SMOOTH = {"interpolate": "monotone"}
MOST_SAMPLES = 200
MOST_SETS = 100
"""Largest number of data sets per scenario in the comparison of two methods."""
MOST_FITS = 2
MOST_ABOVE = 3.0
"""Largest ratio of a drawn fit's error to the smallest one; larger ones would hide the others."""
RECORD = {"sample_times", "sample_values", "sample_dof", "dense_times", "true_displacement"}
UP = "displacement (m)"
Spec = dict[str, Any]


def scenario_data(panel: ScenarioPanel) -> dict[str, Any]:
    """Return the charts of a scenario's page, and the errors over the bound of the first fits by method."""
    fits = {label: logs[0] for label, logs in fits_of(panel.results).items() if logs and logs[0].size}
    errors = {title(label): packed(np.exp(losses[:MOST_SETS])) for label, losses in fits.items()}
    return {"charts": {"record": record(panel), "spread": spread(panel)}, "errors": errors}


def packed(errors: np.ndarray) -> str:
    """Encode errors (n,) as half-precision numbers in base 64."""
    return base64.b64encode(errors.astype("<f2").tobytes()).decode()


def inline(rows: Any) -> Spec:
    """Return a table as data of a chart, in CSV."""
    text = pd.DataFrame(rows).to_csv(index=False, float_format="%.3g", lineterminator="\n")
    return {"values": text, "format": {"type": "csv"}}


def tips(*fields: str) -> list[dict[str, str]]:
    """Return the tooltip of some fields."""
    return [{"field": name} for name in fields]


def chosen(cells: Sequence[Result]) -> list[Result]:
    """Select the cell with the least displacement error, and one with a slightly larger error."""
    order = sorted((c for c in cells if math.isfinite(_median(c))), key=lambda cell: (_median(cell), cell.label))
    order = [cell for cell in order if _median(cell) <= MOST_ABOVE * _median(order[0])]
    places = np.linspace(0, len(order) - 1, min(MOST_FITS, len(order))).round()
    return [order[int(i)] for i in places]


def _median(cell: Result) -> float:
    return cell.statistic("rmse", "median")


def displacement(cell: Result, arrays: Mapping[str, np.ndarray]) -> np.ndarray | None:
    """Return the identified response of the first replicate (n_dof, n_dense), or None."""
    fit = arrays.get("displacement")
    if fit is None and cell.known_model is not None and not cell.truth_drawn and cell.ok[0]:
        with suppress(InputError, np.linalg.LinAlgError):
            fit = simulated(cell, arrays)
    return None if fit is None or not np.isfinite(fit).all() else np.atleast_2d(fit)


def record(panel: ScenarioPanel) -> Spec | None:
    """Chart the first data set: samples, true response, and the fits of some methods; None without stored arrays."""
    cells = {cell.title: (cell, cell.arrays()) for cell in [*chosen(panel.methods), *panel.results]}
    cells = {name: pair for name, pair in cells.items() if set(pair[1]) >= RECORD}
    if not cells:
        return None
    first = next(iter(cells.values()))[1]
    dof, truth = int(first["sample_dof"][0]), np.atleast_2d(first["true_displacement"])
    places = np.unique(np.linspace(0, first["dense_times"].size - 1, POINTS).round().astype(int))
    drawn = {cell.title: displacement(*cells[cell.title]) for cell in chosen(panel.methods) if cell.title in cells}
    fits = {name: fit[dof, places] for name, fit in drawn.items() if fit is not None and fit.shape == truth.shape}
    curves = pd.DataFrame({"time (s)": first["dense_times"][places], "truth": truth[dof, places], **fits})
    samples = pd.DataFrame(np.transpose(samples_of(first, dof)), columns=["time (s)", UP]).head(MOST_SAMPLES)
    x = {"field": "time (s)", "type": "quantitative"}
    y = {"field": UP, "type": "quantitative", "title": f"{UP}, mass {dof + 1} of {len(truth)}" if dof else UP}
    method = {"field": "method", "type": "nominal", "sort": list(fits)}
    fold = {"fold": [escaped_field(name) for name in fits], "as": ["method", UP]}
    tooltip = tips("method", "time (s)", UP)
    return {
        "height": 300,
        "data": inline(curves),
        "encoding": {"x": x},
        "layer": [
            {"mark": {"type": "line", "strokeWidth": 6, "style": "region", **SMOOTH},
             "encoding": {"y": {**y, "field": "truth"}}},
            {"transform": [fold], "mark": {"type": "line", "strokeWidth": 1.6, **SMOOTH},
             "encoding": {"y": y, "color": method, "strokeDash": method, "tooltip": tooltip}},
            {"data": inline(samples), "mark": {"type": "point", "filled": True, "size": 28, "style": "ink"},
             "encoding": {"y": y, "tooltip": tooltip[1:]}},
        ],
    }  # fmt: skip


def escaped_field(name: str) -> str:
    """Escape the name of a column for Vega, which reads dots and brackets as paths."""
    return re.sub(r"([.\[\]\\'\"])", r"\\\1", name)


def spread(panel: ScenarioPanel) -> Spec | None:
    """Chart the relative errors (%) of the middle 95 % of the data sets by method, the worst first."""
    quantities = [metric for metric in panel.ranked if metric != "rmse"]
    rows = [row for metric in quantities for row in _spreads(panel, metric)]
    if not rows:
        return None
    frame = pd.DataFrame(rows, columns=["quantity", "method", "from", "to"])
    bounds = {quantity(metric): 1.96 * panel.bound(metric) for metric in quantities}
    widest = frame.assign(width=frame[["from", "to"]].abs().max(axis=1)).groupby("quantity")["width"].quantile(0.75)
    reach = (1.1 * np.fmax(widest, 1.5 * pd.Series(bounds))).clip(1e-3, 1e4).round(4)
    ends = {"domainMin": {"expr": "-reach[quantity]"}, "domainMax": {"expr": "reach[quantity]"}, "nice": False}
    x = {"field": "from", "type": "quantitative", "title": "relative error (%)", "scale": ends}
    y = {"field": "method", "type": "nominal", "sort": None, "title": None}
    offered = {"input": "select", "options": list(bounds), "name": "Quantity "}
    only = [{"filter": "datum.quantity == quantity"}]
    limits = [{"quantity": name, "from": -value, "to": value} for name, value in bounds.items()]
    return {
        "height": {"step": 22},
        "params": [
            {"name": "quantity", "value": next(iter(bounds)), "bind": offered},
            {"name": "reach", "value": reach.to_dict()},
        ],
        "layer": [
            {"data": inline(limits), "transform": only, "encoding": {"x": x, "x2": {"field": "to"}},
             "mark": {"type": "rect", "style": "region", "clip": True, "aria": False}},
            {"data": {"values": [{}]}, "mark": {"type": "rule", "style": "ink", "aria": False},
             "encoding": {"x": {"datum": 0}}},
            {"data": inline(frame), "transform": only, "mark": {"type": "rule", "strokeWidth": 5, "clip": True},
             "encoding": {"x": x, "x2": {"field": "to"}, "y": y, "tooltip": tips("method", "from", "to")}},
        ],
    }  # fmt: skip


def _spreads(panel: ScenarioPanel, metric: str) -> Iterator[tuple[Any, ...]]:
    """Yield the lines of one quantity."""
    for cell in sorted(panel.results, key=lambda c: (-_excess(c, metric), c.label)):
        ratios = cell.scores(f"{metric.removesuffix(ERROR)}_ratio")
        ratios = ratios[np.isfinite(ratios)]
        if cell.method != "prior" and ratios.size:
            yield quantity(metric), cell.title, *(100 * (np.percentile(ratios, (2.5, 97.5)) - 1))


def _excess(cell: Result, metric: str) -> float:
    value = cell.excess(metric)
    return value if math.isfinite(value) else math.inf
