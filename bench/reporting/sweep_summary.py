"""The end of a sweep in the terminal: few cells one by one, many summarised by method, and what failed."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from functools import partial
from statistics import median_high

import numpy as np

from bench.reporting.frame import Line, Result, group
from bench.reporting.ranking import LOST, competes, determined_bounds, example_problem, leaders, log_errors, ranked
from bench.reporting.rounding import answered, percent, readable, rounded, short_excess, time_text
from bench.reporting.terminal import table, wrapped
from bench.reporting.terminal_tables import ERROR, disturbance_of, failures
from bench.store.cell import Cell
from bench.store.stored_cell import StoredCell

LOG = logging.getLogger("bench")
MOST_ROWS = 12
"""Largest number of cells that are listed one by one unless every cell is wanted; a screen of 24 lines holds them."""
MARK = "+"
FIRST_TIER = "first tier: error over bound not significantly different from the smallest on the same data (95 %)"
LEGEND = (
    "excess: median over cells of the root mean square error over the Cramér-Rao bound; outliers: share of fits with "
    "an error beyond five times the bound, or without an estimate; coverage: share of 95 % intervals that contain the "
    "true value; time: median per fit, start-up of a batch included; {tier}-v lists every cell"
)
TIER = "tier: 1 for the methods not significantly different from the best (95 %), - for methods not ranked; "
SHARED = ("system", "SNR dB", "initial state", "disturbance")
"""Fields of a cell that are stated also where all cells share them; other fields only where cells differ in them."""
OF_SYSTEM, OF_CELL = ("samples", "duration s"), ("replicates", "seed")
NUMBERS = ("SNR dB", *OF_SYSTEM, *OF_CELL)


class SweepSummary:
    """The results of a sweep, collected cell by cell; of each cell one row is kept."""

    def __init__(self) -> None:
        self.rows: list[Line] = []
        self.failures: dict[tuple[str, str, str], tuple[int, str]] = {}
        self.identities: set[str] = set()
        self.not_computed = 0

    def add(self, cell: Cell, stored: StoredCell | None) -> None:
        """Add the result of one cell, None where it was not computed; a cell that was added before is ignored."""
        if cell.identity in self.identities:
            return
        self.identities.add(cell.identity)
        if stored is None:
            self.not_computed += 1
            return
        scenario, result = cell.scenario, Result.of_cell(cell, stored)
        quantity = scenario.make_system().groups[0].name
        metrics, seconds = (quantity + ERROR, "rmse"), stored.columns.numbers("wall_s")
        bounds = determined_bounds([result])
        self.rows.append(
            {
                "method": cell.label, "system": scenario.label, "SNR dB": f"{scenario.snr_db:g}",
                "initial state": scenario.initial_state, "disturbance": disturbance_of(scenario),
                "prior": scenario.prior.name if scenario.prior else "none", "samples": scenario.samples,
                "duration s": scenario.duration, "replicates": cell.replicates, "seed": cell.seed,
                "quantity": readable(quantity), "identity": cell.identity, "n_ok": stored.n_ok, "n": len(stored.rows),
                "scenario": None if result.is_reference else result.question,
                "summaries": [stored.summary.get(metric, {}) for metric in metrics],
                "logs": [log_errors(result, {metric: result.bound(metric)}) for metric in metrics],
                "log_errors": log_errors(result, bounds) if bounds else None,
                "competes": not result.is_reference and competes(result, partial(example_problem, result)),
                "covered": result.successful(f"{quantity}_coverage_95"),
                "wall_s": float(np.nanmedian(seconds)) if np.isfinite(seconds).any() else math.nan,
            }
        )  # fmt: skip
        for (status, message), n in failures(stored).items():
            kind = (cell.label, status, message)
            before, identity = self.failures.get(kind, (0, stored.identity if stored.tracebacks else ""))
            self.failures[kind] = before + n, identity

    def text(self, every_cell: bool = False) -> str:
        """Return the table of cells where they are few or wanted, and that of methods where the cells are many."""
        many = len(self.rows) > MOST_ROWS
        parts = [self.cells_table()] if every_cell or not many else []
        return "\n\n".join([*parts, *([self.methods_table()] if many else [])])

    def cells_table(self) -> str:
        """Return a row for each cell below the fields that all share, with the first tier of each scenario marked."""
        varying = self._varying()
        quantities = {row["quantity"] for row in self.rows}
        first = ["method", *varying] + ["quantity"] * (len(quantities) > 1)
        tiers = [self._first_tiers(i) for i in range(2)]
        rows = []
        for row in self.rows:
            cells = [*(f"{row[name]}" for name in first), answered(row["n_ok"], row["n"])]
            for summary, tier in zip(row["summaries"], tiers, strict=True):
                median = rounded(*(summary.get(key, math.nan) for key in ("median", "ci_low", "ci_high")))[0]
                mark = f"{MARK} " if row["identity"] in tier and row["n_ok"] else ""
                cells += [mark + median, short_excess(summary.get("excess", math.nan))]
            rows.append(cells)
        error = "error %" if len(quantities) > 1 else f"{''.join(quantities)} %"
        headers = [*first, "ok", error, "excess", "RMSE m", "excess"]
        parts = [
            self._shared(varying),
            table(rows, headers, [i for i, name in enumerate(first) if name not in NUMBERS]),
            wrapped(f"{MARK} {FIRST_TIER}") if any(tiers) else "",
        ]
        return "\n\n".join(part for part in parts if part)

    def methods_table(self) -> str:
        """Return a row for each method: cells, successful fits, excess, outlier fits, coverage, time per fit, tier."""
        tiers = self._tiers()
        by_method = group(self.rows, lambda row: row["method"])
        rows = []
        for method in [*tiers, *(method for method in by_method if method not in tiers)]:
            cells = by_method[method]
            excess = [row["summaries"][0].get("excess", math.nan) for row in cells]
            served = [row for row in cells if row["competes"] or row["n_ok"]]  # not: not applicable, not installed
            logs = [row["log_errors"] for row in served if row["log_errors"] is not None]
            covered = np.concatenate([row["covered"] for row in cells])
            rows.append(
                [
                    method, str(len(cells)), answered(*(sum(row[key] for row in cells) for key in ("n_ok", "n"))),
                    short_excess(_middle(excess)),
                    percent(float(np.mean(np.concatenate(logs) == LOST)) if logs else math.nan, 1),
                    percent(float(covered.mean()) if covered.size else math.nan),
                    time_text(_middle([row["wall_s"] for row in cells])),
                    *([str(tiers.get(method) or "-")] if tiers else []),
                ]
            )  # fmt: skip
        quantities = {row["quantity"] for row in self.rows}
        excess_heading = "excess" if len(quantities) > 1 else f"{''.join(quantities)} excess"
        headers = ["method", "cells", "ok", excess_heading, "outliers %", "coverage %", "time", *["tier"] * bool(tiers)]
        parts = [
            self._shared(self._varying()),
            table(rows, headers),
            wrapped(LEGEND.format(tier=TIER if tiers else "")),
        ]
        return "\n\n".join(part for part in parts if part)

    def report_failures(self) -> int:
        """Report on the error stream what failed, once for each kind; return the exit status, 0 or 1.

        It is 1 where a cell was not computed, as where the node that a job ran on was lost.
        """
        for (label, status, message), (n, identity) in self.failures.items() if len(self.rows) > 1 else ():
            where = f" (traceback: python -m bench status cell={identity})" if identity else ""
            LOG.warning("%s: %d x %s: %s%s", label, n, status, message, where)
        if self.not_computed:
            LOG.error("%d cells were not computed; run the same command again", self.not_computed)
        return int(self.not_computed > 0)

    def _varying(self) -> list[str]:
        """Return the fields in which cells differ."""
        values = {name: {row[name] for row in self.rows} for name in (*SHARED, "prior", *OF_SYSTEM, *OF_CELL)}
        several = len(values["system"]) > 1  # each with its own number of samples
        return [name for name, kinds in values.items() if len(kinds) > 1 and not (several and name in OF_SYSTEM)]

    def _shared(self, varying: Sequence[str]) -> str:
        shared = [f"{name} {self.rows[0][name]}" for name in SHARED if self.rows and name not in varying]
        return wrapped(f"every cell: {', '.join(shared)}") if shared else ""

    def _first_tiers(self, i: int) -> set[str]:
        """Return the cells of the first tier by the i-th metric in each scenario."""
        by_scenario = group((row for row in self.rows if row["scenario"]), lambda row: row["scenario"]).values()
        return set().union(*(leaders({row["identity"]: row["logs"][i] for row in cells}) for cells in by_scenario))

    def _tiers(self) -> dict[str, int]:
        """Return the tier of each method, the first tier first, 0 for a method that does not serve every scenario.

        It is empty where there is one method alone, or several cells of one method in one scenario.
        """
        rivals = [row for row in self.rows if row["scenario"]]
        by_key = {(row["method"], row["scenario"]): row for row in rivals}
        methods = list(dict.fromkeys(row["method"] for row in rivals))
        scenarios = sorted({row["scenario"] for row in rivals if row["log_errors"] is not None})
        if len(methods) < 2 or len(by_key) < len(rivals) or not scenarios:
            return {}
        fits = {method: [_losses(by_key.get((method, name))) for name in scenarios] for method in methods}
        return {line.label: line.tier for line in ranked(fits)}


def _losses(row: Line | None) -> np.ndarray:
    """Return log error over bound of the fits of a cell (n,); empty where its method does not serve the scenario."""
    if row is None or not row["competes"]:
        return np.empty(0)
    return np.full(row["n"], LOST) if row["log_errors"] is None else row["log_errors"]


def _middle(values: Sequence[float]) -> float:
    finite = [value for value in values if not math.isnan(value)]
    return median_high(finite) if finite else math.nan
