"""All scenarios of Tables 4 and 5 together: how much worse each method is than the best, and how sure that is.

First, where it has run, the open split, on which nothing was tuned (:mod:`bench.reporting.tables.open_split`).
Every method is compared with the best one on the same data sets, over scenarios as clusters
(:mod:`bench.scoring.comparison`); performance profiles say on what share of the data sets it is within a factor of the
least error.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from bench.reporting.frame import Frame, Line, Result, group
from bench.reporting.labels import title
from bench.reporting.rounding import excess_text, number, percent
from bench.reporting.tables.open_split import bounds_of, over_bounds
from bench.reporting.tables.pooling import root_mean_square
from bench.reporting.tables.render import MISSING, PRIMARY, Columns, Rows, bold, files, listing
from bench.reporting.verdict import below, suspicious
from bench.scoring.comparison import GROSS, STEADY, Errors, compare, gross, profile, steady

COLUMNS = (
    "initial_state", "metric", "open_median", "open_gross", "open_n", "method", "ratio", "low", "high", "p_holm", "tie",
    "gross", "within_1.1", "within_1.5", "within_2", "within_5",
)  # fmt: skip
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


def collected(results: Iterable[Result], metric: str) -> tuple[Errors, np.ndarray] | None:
    """The errors of every method on the replicates that all were given, and the bound of each data set (n,).

    None where a cell is missing. A method that is asked for some of the scenarios only is left out. Where there is no
    bound, 1 stands for it.
    """
    # by identity: the reference system at 20 dB stands in two tables
    own = {result.identity: result for result in results if not result.is_reference}
    asked = group(own.values(), lambda result: result.label)
    most = max(map(len, asked.values()), default=0)
    by_method = {method: its for method, its in asked.items() if len(its) == most}
    if not by_method or not all(result.stored for its in by_method.values() for result in its):
        return None
    fewest = min(result.n for its in by_method.values() for result in its)
    joined = {m: np.concatenate([one.errors(metric)[:fewest] for one in its]) for m, its in by_method.items()}
    bounds = [one.bound(metric) for one in next(iter(by_method.values()))]
    sizes = [bound if 0 < bound < math.inf else 1.0 for bound in bounds]
    return Errors(joined, np.repeat(np.arange(len(sizes)), fewest)), np.repeat(sizes, fewest)


OPEN_LEGEND = """Open: on the scenarios of the [open split](open.md) with that initial state, drawn at random and used
for no setting, the median of error over bound, and the share of gross errors (beyond five times the bound, failures
included). A dash: the method is not asked there."""


def on_open_split(results: Iterable[Result], metric: str) -> dict[str, Line]:
    """By method, its errors over bounds on the scenarios of the open split; none where it has not run."""
    own = list(results)
    bounds = bounds_of(own, metric)
    found = {name: over_bounds(its, metric, bounds) for name, its in group(own, lambda result: result.label).items()}
    return {name: one for name, one in found.items() if one["n"]}


def lines(errors: Errors, bounds: np.ndarray) -> list[Line]:
    """One line a method, best first."""
    over = {method: own / bounds for method, own in errors.values.items()}
    excess = {method: root_mean_square(ratios[np.isfinite(ratios)]) for method, ratios in over.items()}
    sure, _ = steady(over, excess, 1.0)
    best = min(sure, key=lambda method: float(np.median(over[method])))
    within = profile(errors, FACTORS)
    found = {c.a: c for c in compare(errors, [(method, best) for method in over if method != best])}
    rows = [
        {
            "method": method, "ratio": 1.0, "tie": (not (c := found.get(method)) or c.tie) and method in sure,
            **({"ratio": c.ratio, "low": c.low, "high": c.high, "p_holm": c.adjusted} if c else {}),
            "gross": float(np.mean(gross(over[method], 1.0))),
            **{f"within_{factor:g}": share for factor, share in zip(FACTORS, within[method], strict=True)},
        }
        for method in over
    ]  # fmt: skip
    return sorted(rows, key=lambda row: float(row["ratio"]))


def leaderboard(frames: Sequence[Frame], open_split: Frame | None = None) -> Mapping[str, str]:
    """The files by name, from the frames of :data:`EXPERIMENTS`; none where a cell of theirs is missing.

    ``open_split``: the frame of the open split, for the first columns; None where there is none.
    """
    results = [result for frame in frames for result in frame]
    drawn = list(open_split) if open_split and open_split.any_stored else []
    parts: list[str | Rows] = ["# Leaderboard", "", OPEN_LEGEND if drawn else ""]
    data: list[Line] = []
    for start in ("unknown", "known"):
        for metric in PRIMARY:
            found = collected([result for result in results if result.initial_state == start], metric)
            if found is None:
                return {}
            first = on_open_split([result for result in drawn if result.initial_state == start], metric)
            place = {"initial_state": start, "metric": metric}
            own = [{**place, **_open(first.get(one["method"])), **one} for one in lines(*found)]
            data += own
            parts[1] = LEGEND.format(n=int(np.sum(found[0].scenario == 0)), steady=STEADY, gross=GROSS)
            columns = {**NAMED, **(ON_OPEN_SPLIT if drawn else {}), **ON_TABLES}
            parts += [f"## Error of {NAMES[metric]}, initial state {start}", listing(own, columns)]
    small = {title(r.label) for r in results if not r.is_reference and r.stored and suspicious(r.stored)}
    parts += [f"Errors are {below(sorted(small))}." if small else ""]
    parts.append("Regenerate: `python -m bench -m experiment=table4,table5 && python -m bench tables`")
    return files("leaderboard", parts, data, COLUMNS, 5)


def _open(found: Line | None) -> Line:
    if found is None:
        return {"open_n": 0}
    return {"open_median": found["median_over_bound"], "open_gross": found["gross"], "open_n": found["n"]}


def _within(factor: float) -> Callable[[Line], str]:
    return lambda one: f"{percent(one[f'within_{factor:g}'])} %"


NAMED: Columns[Line] = {"method": lambda one: bold(title(one["method"]), one["tie"])}
ON_OPEN_SPLIT: Columns[Line] = {
    "open: error over bound": lambda one: _times(one["open_median"]) if one["open_n"] else MISSING,
    "open: gross": lambda one: f"{percent(one['open_gross'])} % of {one['open_n']}" if one["open_n"] else MISSING,
}
ON_TABLES: Columns[Line] = {
    "error over the best's": lambda one: f"×{one['ratio']:.3g}{_interval(one)}",
    "p (Holm)": lambda one: f"{one['p_holm']:.2g}" if "p_holm" in one else "",
    "gross": lambda one: f"{percent(one['gross'], 1)} %",
    **{f"within ×{factor:g}": _within(factor) for factor in FACTORS},
}


def _interval(one: Line) -> str:
    known = not math.isnan(one.get("low", math.nan))
    return f" ({number(one['low'])} to {number(one['high'])})" if known else ""


def _times(value: float) -> str:
    return f"×{excess_text(value)}" if math.isfinite(value) else "failed"
