"""Scores for reading in a terminal: of one cell, of a sweep with its best methods marked."""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from statistics import median_high

from bench.contract.estimate import Status
from bench.reporting.frame import ERROR, Line, Result, group
from bench.reporting.rounding import answered, excess_text, number, readable, rounded
from bench.reporting.terminal import coloured, table, wrapped
from bench.reporting.verdict import good, verdict
from bench.scenario.scenario import Scenario
from bench.store.cell import Cell
from bench.store.stored import StoredCell

MOST_LISTED = 100
"""Cells of a sweep that are listed one by one."""
RMSES = {"rmse": "displacement RMSE m", "rmse_simulated": "simulated RMSE m", "rmse_forecast": "forecast RMSE m"}
MARK = "+"
COLUMNS = ("system", "dB", "start", "disturbance")
"""What a line of a sweep's table is about, beside its method."""


def disturbance_of(scenario: Scenario) -> str:
    """The disturbance of a scenario with its size, or ``none``."""
    return f"{scenario.disturbance.kind} {scenario.disturbance.size:g}" if scenario.disturbance else "none"


def described(scenario: Scenario) -> str:
    """A scenario in a few words."""
    text = f"{scenario.label} {scenario.snr_db:g} dB {scenario.initial_state}"
    return f"{text}, {disturbance_of(scenario)}" if scenario.disturbance else text


def cell_table(cell: Cell, stored: StoredCell) -> str:
    """The scores of one cell: a line for every quantity, and what each column is."""
    scenario = cell.scenario
    disturbed = f"disturbance {disturbance_of(scenario)}, " if scenario.disturbance else ""
    head = (
        f"{cell.label} on {scenario.label}, {scenario.snr_db:g} dB, initial state {scenario.initial_state}, {disturbed}"
        f"{stored.n_ok}/{len(stored.rows)} ok"
    )
    labels = {f"{q.name}_error_pct": f"{readable(q.name)} error %" for q in scenario.make_system().quantities} | RMSES
    rows = [_score_row(stored, name, label) for name, label in labels.items() if name in stored.summary]
    headers = ["", "median", "95 % low", "95 % high", "bound", "excess", "cover %"]
    said = verdict(stored)
    lines = [wrapped(head), "", table(rows, headers), "", coloured(wrapped(said), "green" if good(said) else "yellow")]
    lines += [wrapped(f"{n} x {status}: {message}", "    ", "  ") for (status, message), n in _failures(stored).items()]
    seconds = [row.wall_s for row in stored.rows if math.isfinite(row.wall_s)]
    if seconds:
        lines.append(f"median {number(sorted(seconds)[len(seconds) // 2])} s a fit")
    lines += [wrapped(sentence) for sentence in _searched(stored)]
    legend = "median over replicates, with its 95 % interval; bound: Cramér-Rao bound on the root mean square;"
    lines.append(wrapped(f"{legend} excess: root mean square / bound; cover: how often 95 % intervals hold the truth"))
    if any(row[0].endswith(" *") for row in rows):
        lines.append(wrapped("* not identifiable from these data: the prior sets the scale"))
    return "\n".join(lines)


def _score_row(stored: StoredCell, name: str, label: str) -> list[str]:
    s = stored.summary[name]
    quantity = name.removesuffix("_error_pct")
    star = "" if stored.identifiable.get(quantity, True) else " *"
    coverage = stored.summary.get(f"{quantity}_coverage_95", {}).get("mean", math.nan)
    cover = "-" if math.isnan(coverage) or name in RMSES else f"{100 * coverage:.0f}"
    numbers = rounded(s["median"], s["ci_low"], s["ci_high"])
    return [label + star, *numbers, number(s["bound"]), _excess(s["excess"]), cover]


def _searched(stored: StoredCell) -> list[str]:
    """Where the searches of a cell ended: how many starts reached the best end, and whether that is a minimum."""
    scores = [row.scores for row in stored.rows]
    searched = [own for own in scores if own.get("starts", 1.0) > 1.0]
    sentences = []
    if searched:
        starts, best = (sum(own[name] for own in searched) for name in ("starts", "starts_at_best"))
        alone = sum(own["starts_at_best"] == 1 for own in searched)
        said = f"; in {alone} of {len(searched)} fits the best end was reached from one start alone" if alone else ""
        sentences.append(f"{best:.0f} of {starts:.0f} starts ended at the best objective of their fit{said}")
    certificates = [own["certificate"] for own in scores if "certificate" in own]
    if certificates:
        text = f"is it a minimum? gradient over its largest possible length: {max(certificates):.1g} at most"
        sentences.append(f"{text} (0 at a minimum)")
    return sentences


def _failures(stored: StoredCell) -> Counter[tuple[str, str]]:
    return Counter((row.status.value, row.message[:120]) for row in stored.rows if row.status is not Status.OK)


class Closing:
    """The end of a sweep, gathered cell by cell so that no more than a line of each is held.

    Up to :data:`MOST_LISTED` cells are listed, and the first tier of each scenario is marked; of more, one line stands
    for all that differ by seed or settings only, with the medians over them.
    """

    def __init__(self, n: int) -> None:
        self.listed = n <= MOST_LISTED
        self.lines: list[Line] = []
        self.kinds: dict[tuple[str, str, str], tuple[int, str]] = {}
        self.seen: set[str] = set()
        self.lost = 0

    def add(self, cell: Cell, stored: StoredCell | None) -> None:
        """Take in one cell's result; None where there is none."""
        from bench.reporting.ranking import losses

        self.seen.add(cell.identity)
        if stored is None:
            self.lost += 1
            return
        scenario, result = cell.scenario, Result.of_cell(cell, stored)
        quantity = scenario.make_system().groups[0].name
        metrics, ranked = (quantity + ERROR, "rmse"), self.listed and not result.is_reference
        self.lines.append(
            {
                "method": cell.label, "system": scenario.label, "dB": f"{scenario.snr_db:g}",
                "start": scenario.initial_state, "disturbance": disturbance_of(scenario), "group": readable(quantity),
                "identity": cell.identity, "n_ok": stored.n_ok, "n": len(stored.rows),
                "statistics": [stored.summary.get(metric, {}) for metric in metrics],
                "losses": [losses(result, {m: result.bound(m)}) for m in metrics] if ranked else [],
                "question": result.question,
            }
        )  # fmt: skip
        for (status, message), n in _failures(stored).items():
            kind = (cell.label, status, message)
            before, identity = self.kinds.get(kind, (0, stored.identity if stored.tracebacks else ""))
            self.kinds[kind] = before + n, identity

    def table(self) -> str:
        """Return the sweep as a table; what all lines share is said once above it."""
        names = sorted({line["group"] for line in self.lines})
        varying = [name for name in COLUMNS if len({line[name] for line in self.lines}) > 1]
        first = ["method", *varying, *(["group"] if len(names) > 1 else [])]
        titles = ("error %" if len(names) > 1 else f"{''.join(names)} %", "RMSE m")
        best = [self._best(i) for i in range(len(titles))]
        rows = []
        for lines in group(self.lines, self._row).values():
            cells = [lines[0][name] for name in first] + ([] if self.listed else [str(len(lines))])
            cells.append(answered(*(sum(line[name] for line in lines) for name in ("n_ok", "n"))))
            for i, identities in enumerate(best):
                median, excess = _median_and_excess([line["statistics"][i] for line in lines])
                mark = MARK if lines[0]["identity"] in identities else ""
                cells += [median, *([mark] if identities else []), excess]
            rows.append(cells)
        headers = [*first, *([] if self.listed else ["cells"]), "ok"]
        for title, identities in zip(titles, best, strict=True):
            headers += [title, *([""] if identities else []), "excess"]
        shared = [f"{name} {line[name]}" for line in self.lines[:1] for name in COLUMNS if name not in varying]
        legend = "first tier: not told from the least error over the bound by these replicates (95 %, or 2 % apart)"
        parts = [
            wrapped(f"every cell: {', '.join(shared)}") if shared else "",
            table(rows, headers, [i for i, name in enumerate(first) if name != "dB"]),
            wrapped(f"{MARK} {legend}") if any(best) else "",
        ]
        return "\n\n".join(part for part in parts if part)

    def _row(self, line: Line) -> Hashable:
        return line["identity"] if self.listed else tuple(line[name] for name in ("method", *COLUMNS))

    def _best(self, i: int) -> set[str]:
        """Find the cells of the first tier by the i-th metric, of every scenario that several were fitted to."""
        from bench.reporting.ranking import leaders

        ranked = (line for line in self.lines if line["losses"])
        by_scenario = group(ranked, lambda line: line["question"]).values()
        return set().union(*(leaders({line["identity"]: line["losses"][i] for line in own}) for own in by_scenario))

    def said_of_failures(self) -> int:
        """Say on the error stream what failed, once a kind, and where a traceback is; the exit status, 0 or 1.

        1 where a cell is not there at all: what ran elsewhere may be lost with its node.
        """
        if len({self._row(line) for line in self.lines}) > 1:
            for (label, status, message), (n, identity) in self.kinds.items():
                where = f" (traceback: python -m bench status cell={identity})" if identity else ""
                print(f"bench: {label}: {n} x {status}: {message}{where}", file=sys.stderr)
        if self.lost:
            print(f"bench: {self.lost} cells were not computed; the same command computes them", file=sys.stderr)
        return 1 if self.lost else 0


def _excess(value: float) -> str:
    """An excess without a power of ten, which takes much room, unless it is huge."""
    return f"{value:.0f}" if 1000 <= value < 1e6 else excess_text(value)


def _median_and_excess(found: Sequence[Mapping[str, float]]) -> tuple[str, str]:
    """Of one cell the median, rounded to its interval; of several the medians over them. And the excess."""
    if len(found) == 1:
        s = found[0]
        ends = (s.get(key, math.nan) for key in ("median", "ci_low", "ci_high"))
        return rounded(*ends)[0], _excess(s.get("excess", math.nan))
    values = [[s[key] for s in found if not math.isnan(s.get(key, math.nan))] for key in ("median", "excess")]
    median, excess = (median_high(own) if own else math.nan for own in values)
    return number(median), _excess(excess)
