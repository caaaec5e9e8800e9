"""The table of robustness: how far each disturbance takes each method from what it does on undisturbed data.

It stands for every experiment whose ``table`` has the form ``robustness``: rows are methods, columns disturbances.
Disturbed and undisturbed cells share base noise and nominal values replicate by replicate, so their ratio is far
better known than either of them: its interval resamples pairs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.reporting.frame import ERROR, Frame, Result
from bench.reporting.labels import title as title_of
from bench.reporting.rounding import excess_text, number
from bench.reporting.tables.common import Line, csv, markdown_table
from bench.scoring.statistics import counts
from bench.store.store import Store

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
scenario: what would be possible without the disturbance (noise that is not white and normal has a bound of its own,
which may be lower); for *irregular* by the bound of its own times, which are told. The start is unknown to the methods
unless the column says otherwise. A star marks an entry whose error differs from the undisturbed one of its reading by
more than 1 %, beyond a 95 % interval (bootstrap of pairs: both cells have the same base noise). Failed replicates are
left out of the entry and counted behind it. *oracle* is maximum a posteriori started at the truth, under the same wrong
assumptions: what it loses is not the optimiser's. No method is told of a disturbance, nor that there is one. Ratios
with their intervals are in the CSV."""
TOLD_APART = 0.01
"""A ratio nearer to 1 than this is no change worth a star, however certain (two integrators differ by rounding)."""


@dataclass(frozen=True)
class DisturbedPair:
    """A result and its undisturbed counterpart (its own cell, where it is undisturbed)."""

    disturbed: Result
    plain: Result

    @property
    def kind(self) -> str:
        """What disturbs it, ``none`` where nothing does."""
        return self.disturbed.disturbance or "none"


def pairs(results: Sequence[Result], store: Store) -> list[DisturbedPair]:
    """Every result of an experiment with its counterpart, in order."""
    found = []
    known = {result.identity: result for result in results}
    for result in results:
        assert result.cell is not None
        plain = replace(result.cell, scenario=result.scenario.undisturbed)
        if plain.identity not in known:
            known[plain.identity] = Result.of_cell(plain, store.load(plain.identity))
        found.append(DisturbedPair(result, known[plain.identity]))
    return found


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


def tidy(found: Iterable[DisturbedPair]) -> list[Line]:
    """One line a cell and metric; a cell that was not run has n = 0."""
    return [line for pair in found for line in _lines(pair)]


def _lines(pair: DisturbedPair) -> Iterable[Line]:
    own, plain = pair.disturbed, pair.plain
    head = {
        "disturbance": pair.kind, "size": own.scenario.disturbance.size if own.scenario.disturbance else math.nan,
        "system": own.system, "initial_state": own.initial_state, "snr_db": own.snr_db, "method": own.label,
    }  # fmt: skip
    for metric, _ in PANELS:
        middle, low, high = (math.nan,) * 3
        if own.stored and plain.stored:
            middle, low, high = ratio(own.errors(metric), plain.errors(metric))
        quantity = metric.removesuffix(ERROR)
        yield {
            **head, "metric": metric, "excess": own.excess(metric), "excess_undisturbed": plain.excess(metric),
            "ratio": middle, "ratio_low": low, "ratio_high": high,
            "coverage_95": own.covered(quantity), "coverage_95_undisturbed": plain.covered(quantity),
            "n_ok": own.n_ok, "n_ok_undisturbed": plain.n_ok, "n": own.n,
        }  # fmt: skip


def markdown(experiment: str, title: str, data: Sequence[Line]) -> str:
    """The table for reading: a panel a metric, then the coverage of the 95 % interval of k/m."""
    own = {metric: [line for line in data if line["metric"] == metric] for metric, _ in PANELS}
    parts = [f"# {title}", LEGEND]
    for metric, heading in PANELS:
        parts += [f"## {heading}", _panel(own[metric], _excess_entry)]
    parts += ["## Coverage of the 95 % interval of k/m, in percent", _panel(own[COVERED], _coverage)]
    missing = sum(line["n"] == 0 for line in own[COVERED])
    parts += [f"{missing} cells were not run."] if missing else []
    parts.append(f"Regenerate: `python -m bench -m experiment={experiment} && python -m bench tables`")
    return "\n\n".join(parts) + "\n"


def _panel(data: Sequence[Line], entry: Callable[[Line], str]) -> str:
    columns = list(dict.fromkeys((line["initial_state"], line["disturbance"]) for line in data))
    lines = {(line["method"], line["initial_state"], line["disturbance"]): line for line in data}
    rows = [
        [title_of(method), *(entry(lines[method, *c]) if (method, *c) in lines else "-" for c in columns)]
        for method in dict.fromkeys(line["method"] for line in data)
    ]
    headers = ["method", *(_name(kind) + (" (start known)" if told == "known" else "") for told, kind in columns)]
    return markdown_table(rows, headers)


def _name(kind: str) -> str:
    return "undisturbed" if kind == "none" else kind.replace("_", " ")


def _excess_entry(line: Line) -> str:
    if not line["n"]:
        return "not run"
    apart = line["ratio_low"] > 1 + TOLD_APART or line["ratio_high"] < 1 - TOLD_APART
    excess, n_ok, n = line["excess"], line["n_ok"], line["n"]
    text = excess_text(excess) if math.isfinite(excess) else number(excess)
    return text + (" *" if apart and line["disturbance"] != "none" else "") + (f" ({n_ok}/{n})" if n_ok < n else "")


def _coverage(line: Line) -> str:
    if not line["n"]:
        return "not run"
    return "-" if math.isnan(line["coverage_95"]) else f"{100 * line['coverage_95']:.0f}"


def robustness_table(frame: Frame, store: Store) -> Mapping[str, str]:
    """The files of an experiment's table by name; none where the store holds no disturbed cell of it."""
    found = pairs(frame.results, store)
    if not any(pair.disturbed.stored for pair in found if pair.kind != "none"):
        return {}
    data = tidy(found)
    return {
        f"{frame.experiment}.md": markdown(frame.experiment, frame.title, data),
        f"{frame.experiment}.csv": csv(data, columns=COLUMNS),
    }
