"""Scores for reading in a terminal: of one cell, and of a sweep with the first tier of each scenario marked."""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from statistics import median_high

from bench.contract.estimate import Status
from bench.reporting.frame import ERROR, Line, Result, group
from bench.reporting.rounding import answered, excess_text, number, readable, rounded
from bench.reporting.terminal import coloured, table, wrapped
from bench.reporting.verdict import good, verdict
from bench.scenario.scenario import Scenario
from bench.store.cell import Cell
from bench.store.stored import StoredCell

MOST_ROWS = 100
"""Rows of a sweep's table at most: of more, cells that differ in one field only are taken together."""
RMSES = {"rmse": "displacement RMSE m", "rmse_simulated": "simulated RMSE m", "rmse_forecast": "forecast RMSE m"}
MARK = "+"
LEGEND = (
    "median over replicates, with its 95 % interval; bound: Cramér-Rao bound on the root mean square; excess: "
    "root mean square / bound; cover: share of 95 % intervals that hold the true value"
)
FIRST_TIER = "first tier: these replicates do not tell it from the least error over the bound (95 %)"
GREEN, YELLOW = 32, 33
SHARED = ("system", "dB", "start", "disturbance")
"""Fields of a cell that a sweep's table says also where all cells share them; the others only where they differ."""
OF_SYSTEM, OF_CELL = ("samples", "duration s"), ("replicates", "seed")


def disturbance_of(scenario: Scenario) -> str:
    """Return the disturbance of a scenario with its size, or ``none``."""
    return f"{scenario.disturbance.kind} {scenario.disturbance.size:g}" if scenario.disturbance else "none"


def described(scenario: Scenario) -> str:
    """Describe a scenario in a few words."""
    text = f"{scenario.label} {scenario.snr_db:g} dB {scenario.initial_state}"
    return f"{text}, {disturbance_of(scenario)}" if scenario.disturbance else text


def cell_table(cell: Cell, stored: StoredCell) -> str:
    """Return the scores of one cell: a line for every quantity, and what each column is."""
    scenario = cell.scenario
    head = f"{cell.label} on {scenario.label}, {scenario.snr_db:g} dB"
    head += f", disturbance {disturbance_of(scenario)}" if scenario.disturbance else ""
    quantities = {f"{q.name}_error_pct": q.name for q in scenario.make_system().quantities}
    labels = {metric: f"{readable(name)} error %" for metric, name in quantities.items()} | RMSES
    rows, open_scale = [], False
    for metric, label in labels.items():
        if metric not in stored.summary:
            continue
        summary, name = stored.summary[metric], quantities.get(metric, "")
        free = not stored.identifiable.get(name, True)
        open_scale |= free
        coverage = stored.summary.get(f"{name}_coverage_95", {}).get("mean", math.nan)
        ends = rounded(summary["median"], summary["ci_low"], summary["ci_high"])
        cover = "-" if math.isnan(coverage) else f"{100 * coverage:.0f}"
        rows.append([label + " *" * free, *ends, number(summary["bound"]), _excess(summary["excess"]), cover])
    said = verdict(stored)
    lines = [
        wrapped(f"{head}, initial state {scenario.initial_state}, {stored.n_ok}/{len(stored.rows)} ok"), "",
        table(rows, ["", "median", "95 % low", "95 % high", "bound", "excess", "cover %"]), "",
        coloured(wrapped(said), GREEN if good(said) else YELLOW),
    ]  # fmt: skip
    lines += [wrapped(f"{n} x {status}: {message}", "    ", "  ") for (status, message), n in _failures(stored).items()]
    seconds = [row.wall_s for row in stored.rows if math.isfinite(row.wall_s)]
    lines += [f"median time of a fit: {number(median_high(seconds))} s"] if seconds else []
    lines += [wrapped(sentence) for sentence in [*_searched(stored), LEGEND]]
    return "\n".join(
        [*lines, *(["* not identifiable from these data: the prior sets the scale"] if open_scale else [])]
    )


def _searched(stored: StoredCell) -> list[str]:
    """Say where the searches of a cell ended: how many starts reached the best end, and whether that is a minimum."""
    scores = [row.scores for row in stored.rows]
    searched = [own for own in scores if own.get("starts", 1.0) > 1.0]
    sentences = []
    if searched:
        starts, best = (sum(own[name] for own in searched) for name in ("starts", "starts_at_best"))
        alone = sum(own["starts_at_best"] == 1 for own in searched)
        said = f"; in {alone} of {len(searched)} fits the best end was reached from one start alone" if alone else ""
        sentences.append(f"{best:.0f} of {starts:.0f} starts ended at the best objective of their fit{said}")
    gradients = [own["certificate"] for own in scores if "certificate" in own]
    if gradients:
        sentences.append(f"convergence: normalized gradient at most {max(gradients):.1g} (0 at a minimum)")
    return sentences


def _failures(stored: StoredCell) -> Counter[tuple[str, str]]:
    return Counter((row.status.value, row.message[:120]) for row in stored.rows if row.status is not Status.OK)


class Closing:
    """The end of a sweep, gathered cell by cell so that no more than a line of each is held."""

    def __init__(self) -> None:
        self.lines: list[Line] = []
        self.failures: dict[tuple[str, str, str], tuple[int, str]] = {}
        self.seen: set[str] = set()
        self.lost = 0

    def add(self, cell: Cell, stored: StoredCell | None) -> None:
        """Take in one cell's result; None where there is none."""
        from bench.reporting.ranking import log_errors

        self.seen.add(cell.identity)
        if stored is None:
            self.lost += 1
            return
        scenario, result = cell.scenario, Result.of_cell(cell, stored)
        quantity = scenario.make_system().groups[0].name
        metrics = (quantity + ERROR, "rmse")
        self.lines.append(
            {
                "method": cell.label, "system": scenario.label, "dB": f"{scenario.snr_db:g}",
                "start": scenario.initial_state, "disturbance": disturbance_of(scenario),
                "prior": scenario.prior.name if scenario.prior else "none", "samples": scenario.samples,
                "duration s": scenario.duration, "replicates": cell.replicates, "seed": cell.seed,
                "group": readable(quantity), "identity": cell.identity, "n_ok": stored.n_ok, "n": len(stored.rows),
                "question": result.question if not result.is_reference else None,
                "statistics": [stored.summary.get(metric, {}) for metric in metrics],
                "losses": [log_errors(result, {metric: result.bound(metric)}) for metric in metrics],
            }
        )  # fmt: skip
        for (status, message), n in _failures(stored).items():
            kind = (cell.label, status, message)
            before, identity = self.failures.get(kind, (0, stored.identity if stored.tracebacks else ""))
            self.failures[kind] = before + n, identity

    def table(self) -> str:
        """Return the sweep as a table; what all lines share is said once above it, and the first tiers are marked."""
        varying = self._varying()
        groups = list(group(self.lines, lambda line: tuple(line[name] for name in ("method", *varying))).values())
        together, quantities = len(groups) < len(self.lines), {line["group"] for line in self.lines}
        first = ["method", *varying] + ["group"] * (len(quantities) > 1)
        headers = [*first, *["cells"] * together, "ok"]
        rows = [
            [*(f"{lines[0][name]}" for name in first), *[str(len(lines))] * together,
             answered(*(sum(line[name] for line in lines) for name in ("n_ok", "n")))]
            for lines in groups
        ]  # fmt: skip
        best = [set() if together else self._leaders(i) for i in range(2)]
        for i, title in enumerate(("error %" if len(quantities) > 1 else f"{''.join(quantities)} %", "RMSE m")):
            headers += [title, "excess"]
            for row, lines in zip(rows, groups, strict=True):
                median, excess = _median_and_excess([line["statistics"][i] for line in lines])
                row += [f"{MARK} {median}" if lines[0]["identity"] in best[i] else median, excess]
        shared = [f"{name} {self.lines[0][name]}" for name in SHARED if self.lines and name not in varying]
        parts = [
            wrapped(f"every cell: {', '.join(shared)}") if shared else "",
            table(rows, headers, [i for i, name in enumerate(first) if name not in ("dB", *OF_SYSTEM, *OF_CELL)]),
            wrapped(f"{MARK} {FIRST_TIER}") if any(best) else "",
        ]
        return "\n\n".join(part for part in parts if part)

    def _varying(self) -> list[str]:
        """Return the fields that cells differ in; of more than :data:`MOST_ROWS` rows without those of most values."""
        values = {name: {line[name] for line in self.lines} for name in (*SHARED, "prior", *OF_SYSTEM, *OF_CELL)}
        several = len(values["system"]) > 1  # each with its own number of samples
        varying = [name for name, own in values.items() if len(own) > 1 and not (several and name in OF_SYSTEM)]
        while varying and len({tuple(line[name] for name in ("method", *varying)) for line in self.lines}) > MOST_ROWS:
            varying.remove(max(varying, key=lambda name: len(values[name])))
        return varying

    def _leaders(self, i: int) -> set[str]:
        """Find the cells of the first tier by the i-th metric, of every scenario that several were fitted to."""
        from bench.reporting.ranking import leaders

        by_scenario = group((line for line in self.lines if line["question"]), lambda line: line["question"]).values()
        return set().union(*(leaders({line["identity"]: line["losses"][i] for line in own}) for own in by_scenario))

    def report_failures(self) -> int:
        """Say on the error stream what failed, once a kind, and where a traceback is; return the exit status, 0 or 1.

        1 where a cell is not there at all: what ran elsewhere may be lost with its node.
        """
        for (label, status, message), (n, identity) in self.failures.items() if len(self.lines) > 1 else ():
            where = f" (traceback: python -m bench status cell={identity})" if identity else ""
            print(f"bench: {label}: {n} x {status}: {message}{where}", file=sys.stderr)
        if self.lost:
            print(f"bench: {self.lost} cells were not computed; the same command computes them", file=sys.stderr)
        return 1 if self.lost else 0


def _excess(value: float) -> str:
    """Write an excess without a power of ten, which takes much room, unless it is huge."""
    return f"{value:.0f}" if 1000 <= value < 1e6 else excess_text(value)


def _median_and_excess(summaries: Sequence[Mapping[str, float]]) -> tuple[str, str]:
    """Return of one cell the median, rounded to its interval; of several the medians over them. And the excess."""
    if len(summaries) == 1:
        ends = (summaries[0].get(key, math.nan) for key in ("median", "ci_low", "ci_high"))
        return rounded(*ends)[0], _excess(summaries[0].get("excess", math.nan))
    values = [[s[key] for s in summaries if not math.isnan(s.get(key, math.nan))] for key in ("median", "excess")]
    median, excess = (median_high(own) if own else math.nan for own in values)
    return number(median), _excess(excess)
