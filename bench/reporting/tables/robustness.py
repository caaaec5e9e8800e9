"""The table of robustness: how far each disturbance takes each method from what it does on undisturbed data.

It stands for every experiment whose ``table`` has the form ``robustness``: rows are methods, columns disturbances.
Disturbed and undisturbed cells share base noise and nominal values replicate by replicate, so their ratio is far
better known than either of them: its interval resamples pairs.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from tabulate import tabulate

from bench.reporting.rounding import excess_text, number
from bench.reporting.tables.tables import TITLES, described_cells, errors_of
from bench.scoring.summary import RESAMPLES
from bench.store.cell import Cell
from bench.store.store import Store, StoredCell

COLUMNS = (
    "disturbance", "size", "system", "initial_state", "snr_db", "method", "metric", "excess", "excess_undisturbed",
    "ratio", "ratio_low", "ratio_high", "coverage_95", "coverage_95_undisturbed", "n_ok", "n_ok_undisturbed", "n",
)  # fmt: skip
PANELS = (
    ("k_over_m_error_pct", "k/m: root mean square error over the bound"),
    ("c_over_m_error_pct", "c/m: root mean square error over the bound"),
    ("rmse", "Displacement: root mean square error over the bound"),
)
COVERED = "k_over_m_error_pct"
LEGEND = """Each entry: root mean square error over the replicates, divided by the Cramér-Rao bound of the *undisturbed*
scenario: what would be possible without the disturbance (other sample times, and noise that is not white and normal,
have bounds of their own, which may be lower). The start is unknown to the methods unless the column says otherwise. A
star marks an entry that differs from the undisturbed one of its reading by more than 1 %, beyond a 95 % interval
(bootstrap of pairs: both cells have the same base noise). Failed replicates are left out of the entry and counted
behind it. *oracle* is maximum a posteriori started at the truth, under the same wrong assumptions: what it loses is
not the optimiser's. No method is told of a disturbance, nor that there is one; the times of *irregular* are told.
Ratios with their intervals are in the CSV."""
TOLD_APART = 0.01
"""A ratio nearer to 1 than this is no change worth a star, however certain (two integrators differ by rounding)."""


@dataclass(frozen=True)
class Pair:
    """A cell and its undisturbed counterpart (itself, where it is undisturbed), with what the store holds of both."""

    cell: Cell
    stored: StoredCell | None
    undisturbed: StoredCell | None

    @property
    def kind(self) -> str:
        disturbance = self.cell.scenario.disturbance
        return disturbance.kind if disturbance else "none"


def pairs(cells: Sequence[Cell], store: Store) -> list[Pair]:
    """Every cell with its counterpart, in order."""
    found = []
    for cell in cells:
        plain = replace(cell, scenario=cell.scenario.undisturbed)
        found.append(Pair(cell, store.load(cell.identity), store.load(plain.identity)))
    return found


def ratio(disturbed: np.ndarray, undisturbed: np.ndarray) -> tuple[float, float, float]:
    """Root mean square over root mean square of paired errors, shape (n,), with its 95 % bootstrap interval.

    Pairs in which either failed (not finite) are left out; NaNs where fewer than two are left.
    """
    good = np.isfinite(disturbed) & np.isfinite(undisturbed)
    squares = np.stack([disturbed[good], undisturbed[good]]) ** 2
    if good.sum() < 2 or not np.any(squares[1]):
        return math.nan, math.nan, math.nan
    index = np.random.default_rng(0).integers(0, squares.shape[1], (RESAMPLES, squares.shape[1]))
    above, below = squares[:, index].mean(axis=2)
    low, high = np.quantile(np.sqrt(above / np.maximum(below, np.finfo(float).tiny)), [0.025, 0.975])
    middle = squares.mean(axis=1)
    return float(np.sqrt(middle[0] / middle[1])), float(low), float(high)


def tidy(found: Sequence[Pair]) -> pd.DataFrame:
    """One line a cell and metric; a cell that was not run has n = 0."""
    return pd.DataFrame([line for pair in found for line in _lines(pair)], columns=list(COLUMNS))


def _lines(pair: Pair) -> Iterable[dict[str, Any]]:
    scenario = pair.cell.scenario
    head = {
        "disturbance": pair.kind, "size": scenario.disturbance.size if scenario.disturbance else math.nan,
        "system": scenario.label, "initial_state": scenario.told, "snr_db": scenario.snr_db, "method": pair.cell.label,
    }  # fmt: skip
    stored, plain = pair.stored, pair.undisturbed
    for metric, _ in PANELS:
        middle, low, high = (math.nan,) * 3
        if stored and plain:
            middle, low, high = ratio(errors_of(stored, metric), errors_of(plain, metric))
        yield {
            **head, "metric": metric, "excess": _value(stored, metric, "excess"),
            "excess_undisturbed": _value(plain, metric, "excess"),
            "ratio": middle, "ratio_low": low, "ratio_high": high,
            "coverage_95": _covered(stored, metric), "coverage_95_undisturbed": _covered(plain, metric),
            "n_ok": stored.n_ok if stored else 0, "n_ok_undisturbed": plain.n_ok if plain else 0,
            "n": len(stored.rows) if stored else 0,
        }  # fmt: skip


def _value(stored: StoredCell | None, metric: str, key: str) -> float:
    return stored.summary.get(metric, {}).get(key, math.nan) if stored else math.nan


def _covered(stored: StoredCell | None, metric: str) -> float:
    """Fraction of 95 % intervals that hold the truth; the displacement has no such interval."""
    if not metric.endswith("_error_pct"):
        return math.nan
    return _value(stored, metric.replace("_error_pct", "_coverage_95"), "mean")


def markdown(experiment: str, title: str, data: pd.DataFrame) -> str:
    """The table for reading: a panel a metric, then the coverage of the 95 % interval of k/m."""
    parts = [f"# {title}", LEGEND]
    for metric, heading in PANELS:
        parts += [f"## {heading}", _panel(data[data.metric == metric], _excess_entry)]
    parts += ["## Coverage of the 95 % interval of k/m, in percent", _panel(data[data.metric == COVERED], _coverage)]
    missing = int((data[data.metric == COVERED].n == 0).sum())
    parts += [f"{missing} cells were not run."] if missing else []
    parts.append(f"Regenerate: `python -m bench -m experiment={experiment} && python -m bench.tables`")
    return "\n\n".join(parts) + "\n"


def _panel(data: pd.DataFrame, entry: Any) -> str:
    columns = list(dict.fromkeys(zip(data.initial_state, data.disturbance, strict=True)))
    lines = {(line.method, line.initial_state, line.disturbance): line for line in data.itertuples()}
    rows = [
        [TITLES.get(method, method), *(entry(lines[method, *c]) if (method, *c) in lines else "-" for c in columns)]
        for method in dict.fromkeys(data.method)
    ]
    headers = ["method", *(_name(kind) + (" (start known)" if told == "known" else "") for told, kind in columns)]
    return tabulate(rows, headers=headers, tablefmt="github", disable_numparse=True)


def _name(kind: str) -> str:
    return "undisturbed" if kind == "none" else kind.replace("_", " ")


def _excess_entry(line: Any) -> str:
    if not line.n:
        return "not run"
    differs = line.disturbance != "none" and (line.ratio_low > 1 + TOLD_APART or line.ratio_high < 1 - TOLD_APART)
    text = excess_text(line.excess) if math.isfinite(line.excess) else number(line.excess)
    return text + (" *" if differs else "") + (f" ({line.n_ok}/{line.n})" if line.n_ok < line.n else "")


def _coverage(line: Any) -> str:
    if not line.n:
        return "not run"
    return "-" if math.isnan(line.coverage_95) else f"{100 * line.coverage_95:.0f}"


def robustness_table(experiment: str, store: Store) -> dict[str, str]:
    """The files of an experiment's table by name; none where the store holds no disturbed cell of it."""
    title, cells = described_cells(experiment)
    found = pairs(cells, store)
    if not any(pair.stored for pair in found if pair.kind != "none"):
        return {}
    data = tidy(found)
    return {
        f"{experiment}.md": markdown(experiment, title, data),
        f"{experiment}.csv": data.to_csv(index=False, float_format="%.6g"),
    }
