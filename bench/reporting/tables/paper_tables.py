"""Tables 2 to 5: every method beside the paper's numbers, from stored cells alone.

A table is what its experiment in ``conf`` describes; a cell that the store lacks is a row that says so.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from bench.reporting.frame import Frame, Line, Result, group, line, quantity
from bench.reporting.labels import title, told
from bench.reporting.paper import paper_value
from bench.reporting.rounding import answered, number, percent, with_excess
from bench.reporting.tables.render import MISSING, PRIMARY, Columns, Rows, bold, ending, files, listing, ranked, texts
from bench.reporting.tables.tidy import printed, row_of
from bench.scoring.comparison import ScenarioRanking
from bench.scoring.statistics import bias_share

COLUMNS = (
    "table", "row", "system", "initial_state", "snr_db", "method", "metric", "mean", "median", "ci_low", "ci_high",
    "bound", "prior_share", "excess", "bias_share", "n_ok", "n", "paper", "verdict",
)  # fmt: skip
HEADINGS = {
    "k_over_m_error_pct": "k/m error %", "c_over_m_error_pct": "c/m error %", "rmse": "RMSE (m)",
    "m_error_pct": "m error %", "c_error_pct": "c error %", "k_error_pct": "k error %",
}  # fmt: skip
"""The metrics of these tables, in order, and what stands over them."""
FIRST = {4: "set", 5: "SNR (dB)"}
"""What the rows of a table with several are told apart by."""
Standings = Mapping[tuple[str, str, str], ScenarioRanking | None]
"""By reading of the initial state, row and metric, where the methods stand; reference rows apart."""
LEGEND = """Each entry: median over the replicates, and after × the excess: root mean square error over the bound, 1
being the best that an unbiased method can do. The row *bound* gives the Cramér-Rao bound on the root mean square (a
median lies below a root mean square: about 0.67 of it for a normal error), and below it how much of its variance is
the prior's: 0 % is told by the data, 100 % by the prior alone (`python -m bench identifiability` says more). *oracle*
is maximum a posteriori started at the truth, *prior* the nominal values without any data. Free vibration tells k/m
and c/m only: m, and what follows from it, is decided by the prior. All 95 % intervals are in the CSV. A failed
replicate counts as an infinite error in medians; the excess is over the successful ones, and ×>1e6 where some ran
away. Bold: the method of least median error, and all that cannot be told from it on the same data (Wilcoxon's
signed-rank test, Holm's adjustment, 5 %) or are less than 2 % from it, unless gross errors now and then double its
excess. Told: what a method uses beyond the data; *start* where it is known, *prior* natively, or *after*, by one step
that all such methods share. bias² %: the share of the mean square errors of k/m and c/m that is the square of their
mean error, what more replicates would not average out (less what chance makes of no bias); the rest is scatter.
ok: fits that gave an answer, of all."""


# ---- the tidy table


def lines(table: int, results: Sequence[Result]) -> list[Line]:
    """One line a metric: every method, the bound, and the paper's number with its verdict."""
    stored = [result for result in results if result.stored]
    places = group(stored, lambda result: (result.initial_state, row_of(table, result)))
    oracles = {place: next((one for one in own if one.method == "oracle"), None) for place, own in places.items()}
    found: list[Line] = []
    for result in results:
        place = (result.initial_state, row_of(table, result))
        head = {"table": table, "row": place[1]}
        if result in places.get(place, [])[:1]:
            bounded = [metric for metric in result.summary if math.isfinite(result.bound(metric))]
            columns = ("system", "initial_state", "snr_db", "metric", "bound", "prior_share")
            found += [{**head, **line(result, metric, columns), "method": "bound"} for metric in bounded]
        for metric in result.summary if result.stored else HEADINGS:
            if metric != "realised_snr_db":
                # the prior's share of the bound stands in the bound's line
                own = {**line(result, metric, COLUMNS), "prior_share": math.nan}
                found.append({**head, **own, **printed(table, result, oracles.get(place), metric)})
    return found


# ---- for reading


def _panel(table: int, results: Sequence[Result], standings: Standings) -> Rows:
    """The rows of one reading of the initial state: of each row of the table the bound, then every method."""
    first = FIRST.get(table)
    lines = [
        {first or "": row, **cells}
        for row, own in group(results, lambda result: row_of(table, result)).items()
        for cells in (*_bound(own), *(_cells(table, row, result, standings) for result in own))
    ]
    return texts(lines, [*([first] if first else []), "method", *HEADINGS.values(), "bias² %", "told", "ok"])


def _bound(own: Sequence[Result]) -> Iterator[dict[str, str]]:
    """The bound, and what of it is the prior's."""
    stored = next((result for result in own if result.stored), None)
    if stored:
        bounds = {name: metric for metric, name in HEADINGS.items() if math.isfinite(stored.bound(metric))}
        dashes = dict.fromkeys(HEADINGS.values(), MISSING)
        sizes = {name: number(stored.bound(metric)) for name, metric in bounds.items()}
        shares = {name: stored.prior_share.get(quantity(metric), math.nan) for name, metric in bounds.items()}
        said = {name: f"{percent(share)} %" for name, share in shares.items() if math.isfinite(share)}
        yield {"method": "bound", **dashes, **sizes}
        yield {"method": "of it from the prior", **dashes, **said}


def _cells(table: int, row: str, result: Result, standings: Standings) -> dict[str, str]:
    """A method's texts by heading."""
    cells = {}
    for metric, name in HEADINGS.items():
        ranking = standings.get((result.initial_state, row, metric))
        cells[name] = bold(_entry(table, row, result, metric), bool(ranking and result.label in ranking.level))
    shares = [bias_share(result.successful(f"{name}_ratio")) for name in ("k_over_m", "c_over_m")]
    last = {"bias² %": ", ".join(map(percent, shares)), "told": told(result.method)}
    return {"method": result.title, **cells, **last, "ok": answered(result.n_ok, result.n)}


def _entry(table: int, row: str, result: Result, metric: str) -> str:
    if result.stored and metric not in result.summary:
        return MISSING
    text = with_excess(result.statistic(metric, "median"), result.excess(metric))
    # the paper's own reading is the known start; its numbers stand beside that panel only
    paper = paper_value(table, row, result.label, metric)
    beside = math.isfinite(paper) and result.initial_state == "known" and result.stored
    return f"{text} (paper {number(paper)})" if beside else text


def _resolved(standings: Standings, start: str) -> str:
    """What these replicates could tell apart."""
    own = [found for (reading, _, _), found in standings.items() if reading == start and found]
    pairs = [c for found in own for c in found.comparisons if math.isfinite(c.resolved)]
    if not pairs:
        return ""
    low, high = min(pairs, key=lambda c: c.resolved), max(pairs, key=lambda c: c.resolved)
    return (
        "The smallest ratio of errors to the best method's that these replicates would tell from 1 with 80 % "
        f"probability: from {low.resolved:.3f} ({title(low.a)}) to {high.resolved:.2f} ({title(high.a)})."
    )


def _paper_legend(results: Sequence[Result]) -> str:
    """What a verdict says, and which of its assumptions are ours."""
    durations = ", ".join(dict.fromkeys(f"{result.duration:g} s" for result in results))
    masses = dict.fromkeys(f"{100 * result.prior['mass']:g} %" for result in results if result.prior)
    return (
        "*Reproduced*: the number lies where 90 in 100 further runs of ours do (single run; known start), and "
        "other means of as many runs (mean; their own sampling error counted). *Not decidable*: our prior "
        "decides. *Open*: the error may follow from that of the mass, for ours is not better in what it implies of k/m "
        "or c/m. Table 2 prints one estimate, a single run. The paper says neither how long its records are nor what "
        f"its prior is: {durations}, and a mass "
        f"weighed to {', '.join(masses)}, are ours ([readings](reproduction.md))."
    )


PRINTED: Columns[Line] = {
    "row": lambda one: one["row"],
    "method": lambda one: title(one["method"]),
    "metric": lambda one: HEADINGS[one["metric"]],
    "paper": lambda one: number(one["paper"]),
    "ours, median (95 %)": lambda one: f"{number(one['median'])} ({number(one['ci_low'])} to {number(one['ci_high'])})",
    "bound": lambda one: number(one["bound"]),
    "verdict": lambda one: one["verdict"],
}
"""The paper's numbers, beside ours."""


def paper_table(frame: Frame) -> Mapping[str, str]:
    """The files of a table of the paper by name; none where the store holds no cell of it."""
    table = frame.number
    if not frame.any_stored or table is None:
        return {}
    places = group(frame, lambda result: (result.initial_state, row_of(table, result)))
    standings = {(*place, metric): ranked(own, metric) for place, own in places.items() for metric in PRIMARY}
    data = lines(table, frame.results)
    beside = [one for one in data if one["initial_state"] == "known" and one.get("paper", math.nan) > 0]
    parts: list[str | Rows] = [f"# {frame.heading}", LEGEND]
    captioned = []
    for start, own in group(frame, lambda result: result.initial_state).items():
        panel = _panel(table, own, standings)
        parts += [f"## Initial state {start}", panel, _resolved(standings, start)]
        said = "Median, and root mean square error over the Cramér-Rao bound."
        captioned.append((f"{frame.title} (initial state {start}). {said}", panel))
    parts += ["## The paper's numbers", _paper_legend(frame.results), listing(beside, PRINTED)]
    return files(frame.name, [*parts, *ending(frame)], data, COLUMNS, latex=captioned)
