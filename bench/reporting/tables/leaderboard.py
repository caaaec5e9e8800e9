"""All scenarios of Tables 4 and 5 together: how much worse each method is than the best, and how sure that is.

First, where it has run, the open split, on which nothing was tuned (:mod:`bench.reporting.tables.open_split`).
Every method is compared with the best one on the same data sets, over scenarios as clusters
(:mod:`bench.scoring.comparison`); performance profiles say on what share of the data sets it is within a factor of the
least error.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.reporting.frame import Frame, Result, group
from bench.reporting.labels import title
from bench.reporting.rounding import excess_text, number
from bench.reporting.tables.common import PRIMARY, bold, csv, markdown_table
from bench.reporting.tables.open_split import Pooled, bounds_of, pooled
from bench.reporting.verdict import below, suspicious
from bench.scoring.comparison import GROSS, STEADY, Errors, compare, gross, profile, steady

EXPERIMENTS = ("table4", "table5")
FACTORS = (1.1, 1.5, 2.0, 5.0)
NAMES = {"k_over_m_error_pct": "k/m", "c_over_m_error_pct": "c/m", "rmse": "displacement"}
LEGEND = """Over the scenarios of Tables 4 and 5, on the first {n} replicates of each, which every method was given.
Ratio: median over the data sets of a method's error over that of the best, with its 95 % interval from a bootstrap that
resamples scenarios as clusters and replicates within them; a failed fit is infinitely bad. The best has the least
median of error over bound of the methods that do not run away: whose excess is within {steady:g} times the least, and
whose errors are gross (beyond {gross:g} times the bound, or failures) no more often than those of the method that makes
fewest (exact test, 5 %). Bold: cannot be told from the best (Wilcoxon's signed-rank test over the data sets, Holm's
adjustment, 5 %), or less than 2 % from it, and does not run away. Within: share of the data sets on which the error is
within so many times the least of all methods (performance profile); near-ties make small factors a lottery."""


@dataclass(frozen=True)
class Collected:
    """The errors of every method on the replicates that all were given, and the bound of each data set (n,)."""

    errors: Errors
    bounds: np.ndarray

    def over_bounds(self) -> dict[str, np.ndarray]:
        """By method its errors over the bounds; over the typical error of all methods where there is no bound."""
        values = self.errors.values
        every = np.stack(list(values.values()))
        usable = np.isfinite(self.bounds) & (self.bounds > 0)
        typical = np.ones(self.bounds.size)
        for scenario in np.unique(self.errors.scenario):
            at = self.errors.scenario == scenario
            finite = every[:, at][np.isfinite(every[:, at])]
            typical[at] = float(np.median(finite)) if finite.size and np.median(finite) > 0 else 1.0
        sizes = np.where(usable, self.bounds, typical)
        return {method: own / sizes for method, own in values.items()}


def collected(results: Iterable[Result], metric: str) -> Collected | None:
    """The errors of every method, and the bounds; None where a cell is missing.

    A method that is asked for some of the scenarios only is left out.
    """
    # by identity: the reference system at 20 dB stands in two tables
    own = {result.identity: result for result in results if not result.is_reference}
    asked = group(own.values(), lambda result: result.label)
    most = max(map(len, asked.values()), default=0)
    by_method = {method: its for method, its in asked.items() if len(its) == most}
    if not by_method or not all(result.stored for its in by_method.values() for result in its):
        return None
    fewest = min(result.n for its in by_method.values() for result in its)
    joined = {
        method: np.concatenate([one.errors(metric)[:fewest] for one in its]) for method, its in by_method.items()
    }  # fmt: skip
    first = next(iter(by_method.values()))
    bounds = np.repeat([one.bound(metric) for one in first], fewest)
    return Collected(Errors(joined, np.repeat(np.arange(len(first)), fewest)), bounds)


OPEN_LEGEND = """Open: on the scenarios of the [open split](open.md) with that initial state, drawn at random and used
for no setting, the median of error over bound, and the share of gross errors (beyond five times the bound, failures
included). A dash: the method is not asked there."""


def on_open_split(results: Iterable[Result], metric: str) -> dict[str, Pooled]:
    """By method, its errors over bounds on the scenarios of the open split; none where it has not run."""
    own = list(results)
    bounds = bounds_of(own, metric)
    found = {method: pooled(its, metric, bounds) for method, its in group(own, lambda result: result.label).items()}
    return {method: one for method, one in found.items() if one.ratios.size}


def lines(own: Collected) -> list[dict[str, Any]]:
    """One line a method, best first."""
    errors, over = own.errors, own.over_bounds()
    excess = {method: _root_mean_square(ratios) for method, ratios in over.items()}
    sure, _ = steady(over, excess, 1.0)
    best = min(sure, key=lambda method: float(np.median(over[method])))
    within = profile(errors, FACTORS)
    found = {c.a: c for c in compare(errors, [(method, best) for method in errors.values if method != best])}
    rows: list[dict[str, Any]] = []
    for method in errors.values:
        c = found.get(method)
        rows.append(
            {
                "method": method, "ratio": c.ratio if c else 1.0, "low": c.low if c else math.nan,
                "high": c.high if c else math.nan, "p_holm": c.adjusted if c else math.nan,
                "tie": (c.tie if c else True) and method in sure, "gross": float(np.mean(gross(over[method], 1.0))),
                **{f"within_{factor:g}": share for factor, share in zip(FACTORS, within[method], strict=True)},
            }
        )  # fmt: skip
    return sorted(rows, key=lambda row: row["ratio"])


def _root_mean_square(ratios: np.ndarray) -> float:
    good = ratios[np.isfinite(ratios)]
    return float(np.sqrt(np.mean(good**2))) if good.size else math.nan


def leaderboard(frames: Sequence[Frame], open_split: Frame | None = None) -> Mapping[str, str]:
    """The files by name, from the frames of :data:`EXPERIMENTS`; none where a cell of theirs is missing.

    ``open_split``: the frame of the open split, for the first columns; None where there is none.
    """
    results = [result for frame in frames for result in frame]
    drawn = list(open_split) if open_split and open_split.any_stored else []
    parts, rows = ["# Leaderboard", ""], []
    for start in ("unknown", "known"):
        panel = [result for result in results if result.initial_state == start]
        for metric in PRIMARY:
            found = collected(panel, metric)
            if found is None:
                return {}
            first = on_open_split([result for result in drawn if result.initial_state == start], metric)
            own = [{**_open_columns(first.get(line["method"])), **line} for line in lines(found)]
            n = int(np.sum(found.errors.scenario == 0))
            parts[1] = LEGEND.format(n=n, steady=STEADY, gross=GROSS) + (f"\n\n{OPEN_LEGEND}" if drawn else "")
            rows += [{"initial_state": start, "metric": metric, **line} for line in own]
            parts += [f"## Error of {NAMES[metric]}, initial state {start}", _table(own, bool(drawn))]
    small = {title(r.label) for r in results if not r.is_reference and r.stored and suspicious(r.stored)}
    parts += [f"Errors are {below(sorted(small))}."] if small else []
    parts.append("Regenerate: `python -m bench -m experiment=table4,table5 && python -m bench tables`")
    return {"leaderboard.md": "\n\n".join(parts) + "\n", "leaderboard.csv": csv(rows, 5)}


def _open_columns(found: Pooled | None) -> dict[str, float]:
    if found is None:
        return {"open_median": math.nan, "open_gross": math.nan, "open_n": 0}
    return {"open_median": found.median, "open_gross": found.gross[0], "open_n": found.ratios.size}


def _table(own: Sequence[dict[str, Any]], with_open: bool) -> str:
    rows = []
    for line in own:
        interval = "" if math.isnan(line["low"]) else f" ({number(line['low'])} to {number(line['high'])})"
        ratio = f"×{line['ratio']:.3g}{interval}"
        p = "" if math.isnan(line["p_holm"]) else f"{line['p_holm']:.2g}"
        shares = [f"{100 * line[f'within_{factor:g}']:.0f} %" for factor in FACTORS]
        first = _open_cells(line) if with_open else []
        often = f"{100 * line['gross']:.1f} %"
        rows.append([bold(title(line["method"]), line["tie"]), *first, ratio, p, often, *shares])
    headers = ["error over the best's", "p (Holm)", "gross", *(f"within ×{factor:g}" for factor in FACTORS)]
    first = ["open: error over bound", "open: gross"] if with_open else []
    return markdown_table(rows, ["method", *first, *headers])


def _open_cells(line: Mapping[str, Any]) -> list[str]:
    if not line["open_n"]:
        return ["-", "-"]
    median = line["open_median"]
    error = f"×{excess_text(median)}" if math.isfinite(median) else "failed"
    return [error, f"{100 * line['open_gross']:.0f} % of {line['open_n']}"]
