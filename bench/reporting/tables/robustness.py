"""The table of robustness: how far each disturbance takes each method from what it does on undisturbed data.

It stands for every experiment whose ``table`` has the form ``robustness``: rows are methods, columns disturbances.
Disturbed and undisturbed cells share base noise and nominal values replicate by replicate, so their ratio is far
better known than either of them: its interval resamples pairs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from bench.reporting.frame import Frame, Line, Result, group, line
from bench.reporting.rounding import excess_text, number, percent
from bench.reporting.tables.render import NAMED, Rows, files, panel
from bench.scoring.statistics import counts
from bench.store.store import Store

COLUMNS = (
    "disturbance", "size", "system", "initial_state", "snr_db", "method", "metric", "excess", "excess_undisturbed",
    "ratio", "ratio_low", "ratio_high", "coverage_95", "coverage_95_undisturbed", "n_ok", "n_ok_undisturbed", "n",
)  # fmt: skip
PANELS = {"k_over_m_error_pct": "k/m", "c_over_m_error_pct": "c/m", "rmse": "Displacement"}
COVERED = "k_over_m_error_pct"
LEGEND = """Each entry: root mean square error over the replicates, divided by the Cramér-Rao bound of the *undisturbed*
scenario: what would be possible without the disturbance (noise that is not white and normal has a bound of its own,
which may be lower); for *irregular* by the bound of its own times, which are told. The start is unknown to the methods
unless the column says otherwise. A star marks an entry whose error differs from the undisturbed one of its reading by
more than 1 %, beyond a 95 % interval (bootstrap of pairs: both cells have the same base noise). Failed replicates are
left out of the entry and counted behind it. *oracle* is maximum a posteriori started at the truth, under the same wrong
assumptions: what it loses is not the optimiser's. No method is told of a disturbance, nor that there is one. Ratios
with their intervals are in the CSV."""
TOLD_APART = 0.01
"""A ratio nearer to 1 than this is no change worth a star, however certain (two integrators differ by rounding)."""


def pairs(results: Sequence[Result], store: Store) -> Iterator[tuple[Result, Result]]:
    """Every result of an experiment with its undisturbed counterpart (itself, where it is undisturbed), in order."""
    known = {result.identity: result for result in results}
    for result in results:
        assert result.cell is not None
        plain = replace(result.cell, scenario=result.scenario.undisturbed)
        if plain.identity not in known:
            known[plain.identity] = Result.of_cell(plain, store.load(plain.identity))
        yield result, known[plain.identity]


def ratio(disturbed: np.ndarray, undisturbed: np.ndarray) -> tuple[float, float, float]:
    """Root mean square over root mean square of paired errors, shape (n,), with its 95 % bootstrap interval.

    Pairs in which either failed (not finite) are left out; NaNs where fewer than two are left.
    """
    good = np.isfinite(disturbed) & np.isfinite(undisturbed)
    squares = np.stack([disturbed[good], undisturbed[good]], axis=1) ** 2
    if good.sum() < 2 or not np.any(squares[:, 1]):
        return math.nan, math.nan, math.nan
    above, below = (counts(len(squares)).T @ squares).T / len(squares)
    low, high = np.quantile(np.sqrt(above / np.maximum(below, np.finfo(float).tiny)), [0.025, 0.975])
    middle = squares.mean(axis=0)
    return float(np.sqrt(middle[0] / middle[1])), float(low), float(high)


def lines(results: Sequence[Result], store: Store) -> list[Line]:
    """One line a cell and metric; a cell that was not run has n = 0."""
    return [_line(*pair, metric) for pair in pairs(results, store) for metric in PANELS]


def _line(own: Result, plain: Result, metric: str) -> Line:
    ratios = ratio(own.errors(metric), plain.errors(metric)) if own.stored and plain.stored else (math.nan,) * 3
    beside = line(plain, metric, ("excess", "coverage_95", "n_ok"))
    return {
        **line(own, metric, COLUMNS), **{f"{name}_undisturbed": value for name, value in beside.items()},
        **dict(zip(("ratio", "ratio_low", "ratio_high"), ratios, strict=True)),
    }  # fmt: skip


def _panel(data: Sequence[Line], entry: Callable[[Line], str]) -> Rows:
    """Methods down, disturbances across."""
    return panel(
        data,
        lambda one: one["method"],
        NAMED,
        lambda one: (one["initial_state"], one["disturbance"]),
        lambda one: {_name(one): lambda it: entry(it) if it["n"] else "not run"},
    )


def _name(one: Line) -> str:
    name = "undisturbed" if one["disturbance"] == "none" else one["disturbance"].replace("_", " ")
    return name + (" (start known)" if one["initial_state"] == "known" else "")


def _excess(one: Line) -> str:
    apart = one["ratio_low"] > 1 + TOLD_APART or one["ratio_high"] < 1 - TOLD_APART
    text = excess_text(one["excess"]) if math.isfinite(one["excess"]) else number(one["excess"])
    star = " *" if apart and one["disturbance"] != "none" else ""
    return text + star + (f" ({one['n_ok']}/{one['n']})" if one["n_ok"] < one["n"] else "")


def robustness_table(frame: Frame, store: Store) -> Mapping[str, str]:
    """The files of an experiment's table by name; none where the store holds no disturbed cell of it."""
    if not any(result.stored for result in frame if result.disturbance):
        return {}
    data = lines(frame.results, store)
    own = group(data, lambda one: one["metric"])
    parts: list[str | Rows] = [f"# {frame.title}", LEGEND]
    for metric, name in PANELS.items():
        parts += [f"## {name}: root mean square error over the bound", _panel(own[metric], _excess)]
    parts += ["## Coverage of the 95 % interval of k/m, in percent"]
    parts += [_panel(own[COVERED], lambda one: percent(one["coverage_95"]))]
    missing = sum(not one["n"] for one in own[COVERED])
    parts += [f"{missing} cells were not run." if missing else "", f"Regenerate: `{frame.command}`"]
    return files(frame.name, parts, data, COLUMNS)
