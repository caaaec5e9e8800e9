"""Tables 2 to 5: every method beside the paper's numbers, from stored cells alone.

A table is what its experiment in ``conf`` describes; a cell that the store lacks is a row that says so.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any

from bench.reporting.bias import bias_share
from bench.reporting.frame import ERROR, Frame, Result, group
from bench.reporting.labels import title, told
from bench.reporting.paper import paper_value, row_name
from bench.reporting.rounding import excess_text, number
from bench.reporting.tables.render import (
    PRIMARY,
    Rows,
    bold,
    csv,
    failure_notes,
    latex_tables,
    markdown_table,
    ranked,
)
from bench.scoring.comparison import ScenarioRanking
from bench.scoring.verdict import Verdict, judge

COLUMNS = (
    "table", "row", "system", "initial_state", "snr_db", "method", "metric", "mean", "median", "ci_low", "ci_high",
    "bound", "prior_share", "excess", "bias_share", "n_ok", "n", "paper", "verdict",
)  # fmt: skip
HEADINGS = {
    "k_over_m_error_pct": "k/m error %", "c_over_m_error_pct": "c/m error %", "rmse": "RMSE (m)",
    "m_error_pct": "m error %", "c_error_pct": "c error %", "k_error_pct": "k error %",
}  # fmt: skip
"""The metrics of these tables, in order, and what stands over them."""
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


def judged(paper: float, result: Result, oracle: Result, metric: str) -> Verdict:
    """The verdict of a cell on a printed number."""
    # the prior's part of this method's own mean square error: a method that is far off is so for other reasons
    share = result.prior_share.get(metric.removesuffix(ERROR), 0.0) / max(result.excess(metric) ** 2, 1.0)
    return judge(paper, result.errors(metric), oracle.errors(metric), share)


class PaperTable:
    """One of Tables 2 to 5: its results by row and by reading of the initial state, and what follows from them."""

    def __init__(self, number: int, heading: str, results: Sequence[Result], command: str = "") -> None:
        self.number, self.heading, self.results, self.command = number, heading, results, command
        self.rows = group(results, lambda result: (result.initial_state, self.row(result)))
        self.readings = list(dict.fromkeys(start for start, _ in self.rows))

    def row(self, result: Result) -> str:
        """The name of the row that a result stands in."""
        return row_name(self.number, result.system, result.snr_db)

    @cached_property
    def standings(self) -> dict[tuple[str, str, str], ScenarioRanking]:
        """By reading, row and metric, where the methods stand; reference rows apart."""
        found = {
            (*place, metric): ranked(own, metric) for place, own in self.rows.items() for metric in PRIMARY
        }  # fmt: skip
        return {place: one for place, one in found.items() if one}

    # ---- the tidy table

    @cached_property
    def lines(self) -> list[dict[str, Any]]:
        """One line a metric: every method, the bound, and the paper's number with its verdict."""
        oracles = {place: _stored(own, "oracle") for place, own in self.rows.items()}
        lines: list[dict[str, Any]] = []
        bounded: set[tuple[str, str]] = set()
        for result in self.results:
            place = (result.initial_state, self.row(result))
            if result.stored and place not in bounded:
                bounded.add(place)
                lines += self._bound_lines(result)
            lines += self._lines(result, oracles[place])
        return lines

    def _head(self, result: Result, method: str, metric: str) -> dict[str, Any]:
        return {
            "table": self.number, "row": self.row(result), "system": result.system,
            "initial_state": result.initial_state, "snr_db": result.snr_db, "method": method, "metric": metric,
        }  # fmt: skip

    def _bound_lines(self, result: Result) -> Iterable[dict[str, Any]]:
        for metric in result.summary:
            if math.isfinite(result.bound(metric)):
                share = result.prior_share.get(metric.removesuffix(ERROR), math.nan)
                yield {**self._head(result, "bound", metric), "bound": result.bound(metric), "prior_share": share}

    def _lines(self, result: Result, oracle: Result | None) -> Iterable[dict[str, Any]]:
        if result.stored is None:
            for metric in HEADINGS:
                yield {**self._head(result, result.label, metric), "n_ok": 0, "n": 0, "verdict": "not run"}
            return
        for metric in result.summary:
            if metric == "realised_snr_db":
                continue
            paper = paper_value(self.number, self.row(result), result.label, metric)
            statistics = ("mean", "median", "ci_low", "ci_high", "bound", "excess")
            yield {
                **self._head(result, result.label, metric),
                **{name: result.statistic(metric, name) for name in statistics},
                "bias_share": bias_share(result.successful(metric.removesuffix(ERROR) + "_ratio")),
                "n_ok": result.n_ok,
                "n": result.n,
                "paper": paper,
                "verdict": _verdict(paper, result, oracle, metric),
            }

    def csv(self) -> str:
        """The tidy table."""
        return csv(self.lines, columns=COLUMNS)

    # ---- for reading

    @cached_property
    def panels(self) -> dict[str, Rows]:
        """By reading of the initial state, the rows and headers that Markdown and LaTeX share."""
        first = {4: "set", 5: "SNR (dB)"}.get(self.number)
        headers = [*([first] if first else []), "method", *HEADINGS.values(), "bias² %", "told", "ok"]
        panels: dict[str, Rows] = {start: ([], headers) for start in self.readings}
        for (start, row), own in self.rows.items():
            head = [row] if first else []
            panels[start][0].extend([*head, *line] for line in self._row(start, row, own))
        return panels

    def _row(self, start: str, row: str, own: Sequence[Result]) -> Iterable[list[str]]:
        """The lines of one row of the table: the bound, what of it is the prior's, and each method."""
        bounded = False
        for result in own:
            if result.stored and not bounded:
                bounded = True
                bounds = {metric: result.bound(metric) for metric in HEADINGS}
                yield ["bound", *(number(one) if math.isfinite(one) else "-" for one in bounds.values()), "", "", ""]
                shares = [
                    result.prior_share.get(metric.removesuffix(ERROR), math.nan) if math.isfinite(one) else math.nan
                    for metric, one in bounds.items()
                ]
                said = [f"{100 * share:.0f} %" if math.isfinite(share) else "-" for share in shares]
                yield ["of it from the prior", *said, "", "", ""]
            cells = []
            for metric in HEADINGS:
                ranking = self.standings.get((start, row, metric))
                leads = ranking is not None and result.label in ranking.level
                cells.append(bold(self._entry(result, metric), leads))
            ok = f"{result.n_ok}/{result.n}" if result.n else "not run"
            yield [result.title, *cells, _bias_shares(result), told(result.method), ok]

    def _entry(self, result: Result, metric: str) -> str:
        if result.stored and metric not in result.summary:
            return "-"
        text = number(result.statistic(metric, "median"))
        if math.isfinite(result.excess(metric)):
            text += f" ×{excess_text(result.excess(metric))}"
        # the paper's own reading is the known start; its numbers stand beside that panel only
        paper = paper_value(self.number, self.row(result), result.label, metric)
        beside = math.isfinite(paper) and result.initial_state == "known" and result.stored
        return f"{text} (paper {number(paper)})" if beside else text

    def _resolved(self, start: str) -> str:
        """What these replicates could tell apart."""
        pairs = [
            c for (own, _, _), found in self.standings.items() if own == start
            for c in found.comparisons if math.isfinite(c.resolved)
        ]  # fmt: skip
        if not pairs:
            return ""
        low, high = min(pairs, key=lambda c: c.resolved), max(pairs, key=lambda c: c.resolved)
        return (
            "The smallest ratio of errors to the best method's that these replicates would tell from 1 with 80 % "
            f"probability: from {low.resolved:.3f} ({title(low.a)}) to {high.resolved:.2f} ({title(high.a)})."
        )

    def _paper_legend(self) -> str:
        """What a verdict says, and which of its assumptions are ours."""
        durations = ", ".join(dict.fromkeys(f"{result.duration:g} s" for result in self.results))
        masses = dict.fromkeys(f"{100 * result.prior['mass']:g} %" for result in self.results if result.prior)
        return (
            "*Reproduced*: the number lies where 90 in 100 further runs of ours do (single run; known start), and "
            "other means of as many runs (mean; their own sampling error counted). *Not decidable*: our prior "
            f"decides. The paper says neither how long its records are nor what its prior is: {durations}, and a mass "
            f"weighed to {', '.join(masses)}, are ours ([readings](reproduction.md))."
        )

    def _paper_panel(self) -> str:
        lines = [
            line for line in self.lines
            if line["initial_state"] == "known" and math.isfinite(line.get("paper", math.nan))
        ]  # fmt: skip
        rows = [
            [
                line["row"],
                title(line["method"]),
                HEADINGS[line["metric"]],
                number(line["paper"]),
                f"{number(line['median'])} ({number(line['ci_low'])} to {number(line['ci_high'])})",
                number(line["bound"]),
                line["verdict"],
            ]
            for line in lines
        ]
        return markdown_table(rows, ["row", "method", "metric", "paper", "ours, median (95 %)", "bound", "verdict"])

    def markdown(self) -> str:
        """A panel for each reading of the initial state, then the paper's numbers with verdicts."""
        parts = [f"# Table {self.number}. {self.heading}", LEGEND]
        for start, panel in self.panels.items():
            parts += [f"## Initial state {start}", markdown_table(*panel), self._resolved(start)]
        parts.append("## The paper's numbers")
        parts += [self._paper_legend(), self._paper_panel()]
        notes = failure_notes(self.results)
        parts += [f"## What failed\n\n{notes}"] if notes else []
        parts.append(f"Regenerate: `{self.command}`")
        return "\n\n".join(parts) + "\n"

    def latex(self) -> str:
        """Both panels, for an article."""
        said = "Median, and root mean square error over the Cramér-Rao bound."
        captions = {start: f"{self.heading} (initial state {start}). {said}" for start in self.panels}
        return latex_tables((captions[start], panel) for start, panel in self.panels.items())


def _bias_shares(result: Result) -> str:
    """The share of bias in the mean square errors of k/m and c/m, in percent."""
    names = [metric.removesuffix(ERROR) for metric in PRIMARY if metric.endswith(ERROR)]
    shares = [bias_share(result.successful(f"{name}_ratio")) for name in names]
    return ", ".join("-" if math.isnan(share) else f"{100 * share:.0f}" for share in shares)


def _stored(results: Iterable[Result], method: str) -> Result | None:
    return next((result for result in results if result.method == method and result.stored), None)


def _verdict(paper: float, result: Result, oracle: Result | None, metric: str) -> str:
    if math.isnan(paper):
        return ""
    return judged(paper, result, oracle, metric).text if oracle else "no oracle stored"


def paper_table(frame: Frame) -> Mapping[str, str]:
    """The files of a table of the paper by name; none where the store holds no cell of it."""
    if not frame.any_stored or frame.number is None:
        return {}
    table = PaperTable(frame.number, frame.title, frame.results, frame.command)
    name = f"table{frame.number}"
    return {f"{name}.md": table.markdown(), f"{name}.csv": table.csv(), f"{name}.tex": table.latex()}
