"""What a scenario's page draws and what two methods are compared by: the first record, deviations, and all errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.reporting.frame import ERROR, Result
from bench.reporting.page.board import short
from bench.reporting.page.first_replicate import first_replicate, stated_interval
from bench.reporting.page.reading import ScenarioPanel
from bench.reporting.page.words import quantity
from bench.store.store import Store

POINTS = 80
MOST_SAMPLES = 200
MOST_FITS = 4
MOST_ABOVE = 3.0
"""A fit whose typical error is more times the least is not drawn over the record: it would hide the others."""
LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_"
DECADES = (-4.0, 5.0)
TOP = len(LETTERS) ** 2 - 1
"""An error over the bound is written as two letters, to half a percent: the place of its logarithm in these decades.

Failed fits have the last place.
"""


def scenario_data(store: Store, panel: ScenarioPanel) -> dict[str, Any]:
    """All of it, as plain lists and numbers."""
    return {
        "record": record(store, panel),
        "spread": {metric: spreads(store, panel, metric) for metric in panel.ranked if metric != "rmse"},
        "bounds": {metric: short(bound_of(panel, metric)) for metric in panel.ranked},
        "errors": {
            metric: {
                c.label: packed(c.errors(metric) / unit(panel, metric)) for c in panel.methods if metric in c.summary
            }
            for metric in panel.ranked
        },
        "names": {metric: quantity(metric) for metric in panel.ranked},
    }


def bound_of(panel: ScenarioPanel, metric: str) -> float:
    """The bound on the root mean square of a metric; NaN where no cell has one."""
    return next((cell.bound(metric) for cell in panel.results if metric in cell.summary), math.nan)


def unit(panel: ScenarioPanel, metric: str) -> float:
    """What errors are counted in: the bound, where there is one."""
    bound = bound_of(panel, metric)
    return bound if math.isfinite(bound) and bound > 0 else 1.0


def packed(errors: np.ndarray) -> str:
    """Errors (n,) as two letters each; failed ones, which are infinite, as the last that there is."""
    low, high = DECADES
    with np.errstate(divide="ignore", invalid="ignore"):
        places = np.clip((np.log10(errors) - low) / (high - low), 0.0, 1.0) * (TOP - 1)
    found = np.where(np.isfinite(errors), np.nan_to_num(places), TOP).round().astype(int)
    return "".join(LETTERS[i // 64] + LETTERS[i % 64] for i in found.tolist())


def chosen(cells: Sequence[Result]) -> list[Result]:
    """A few that differ: the least error of the displacement, one not far above it, and evenly between."""
    order = sorted((c for c in cells if math.isfinite(_median(c))), key=lambda cell: (_median(cell), cell.label))
    order = [cell for cell in order if _median(cell) <= MOST_ABOVE * _median(order[0])]
    if len(order) <= MOST_FITS:
        return order
    return [order[round(i * (len(order) - 1) / (MOST_FITS - 1))] for i in range(MOST_FITS)]


def _median(cell: Result) -> float:
    return cell.statistic("rmse", "median")


def record(store: Store, panel: ScenarioPanel) -> dict[str, Any] | None:
    """The first data set: samples, truth, and some methods' fits; None where no arrays are kept."""
    found = [(cell, first_replicate(store, cell)) for cell in chosen(panel.methods)]
    if not any(kept for _, kept in found):
        found += [(cell, first_replicate(store, cell)) for cell in panel.results]
    kept = next((one for _, one in found if one is not None), None)
    if kept is None:
        return None
    places, step = thinned(kept.dense.size), step_of(float(np.max(np.abs(kept.truth))))
    fits = {c.title: _steps(one.fit[places], step) for c, one in found if one is not None and one.fit is not None}
    return {
        "times": _short(kept.times[:MOST_SAMPLES]), "step": step, "values": _steps(kept.values[:MOST_SAMPLES], step),
        "dense": _short(kept.dense[places]), "truth": _steps(kept.truth[places], step), "fits": fits,
        "where": f"mass {kept.dof + 1} of {kept.dofs}" if kept.dofs > 1 else "",
        "left": max(kept.times.size - MOST_SAMPLES, 0),
    }  # fmt: skip


def step_of(reach: float) -> float:
    """The power of ten that displacements (m) are counted in: a thousandth of their reach, or less."""
    return float(f"1e{math.floor(math.log10(reach)) - 3}") if math.isfinite(reach) and reach > 0 else 1e-6


def _steps(values: np.ndarray, step: float) -> list[int | None]:
    """Displacements (m) as whole numbers of steps, which take less room than decimals."""
    return [round(float(value / step)) if math.isfinite(value) else None for value in values]


def thinned(n: int) -> np.ndarray:
    """Places of at most :data:`POINTS` values, evenly, both ends among them."""
    return np.unique(np.linspace(0, n - 1, POINTS).round().astype(int))


def _short(values: np.ndarray) -> list[float | None]:
    return [short(float(value)) for value in values]


def spreads(store: Store, panel: ScenarioPanel, metric: str) -> list[list[Any]]:
    """By method, worst first: its name, and in percent off the truth the ends of the middle 95 % of all data sets, the
    first data set's value, and the ends of the interval that the method states there."""
    name = metric.removesuffix(ERROR)
    found = []
    for cell in sorted(panel.results, key=lambda c: (-_excess(c, metric), c.label)):
        ratios = cell.scores(f"{name}_ratio")
        ratios = ratios[np.isfinite(ratios)]
        if cell.method == "prior" or not ratios.size:
            continue
        low, high = 100 * (np.percentile(ratios, (2.5, 97.5)) - 1)
        stated = stated_interval(store, cell, name)
        ends = [None, None] if stated is None else [short(100 * (end - 1)) for end in stated]
        first = short(100 * (cell.first(f"{name}_ratio") - 1))
        found.append([cell.title, short(low), short(high), first, *ends])
    return found


def _excess(cell: Result, metric: str) -> float:
    value = cell.excess(metric)
    return value if math.isfinite(value) else math.inf
