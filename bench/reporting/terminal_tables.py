"""The scores of one cell, for reading in a terminal."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from statistics import median_high
from typing import Any

from bench.contract.estimate import Status
from bench.reporting.rounding import number, percent, readable, rounded, short_excess, time_text
from bench.reporting.terminal import coloured, table, wrapped
from bench.reporting.verdict import GOOD, verdict
from bench.scenario.scenario import Scenario
from bench.store.cell import Cell
from bench.store.stored_cell import StoredCell

ERROR = "_error_pct"
RMSES = {"rmse": "displacement RMSE m", "rmse_simulated": "simulated RMSE m", "rmse_forecast": "forecast RMSE m"}
HEADINGS = ("error", "median", "95 % low", "95 % high", "bound", "excess", "coverage %")
NOT_IDENTIFIABLE = "Not identifiable from these data; prior: share of the variance at the bound due to the prior"
LEGEND = (
    "median over replicates with its 95 % interval; bound: Cramér-Rao bound on the root mean square error; excess: "
    "root mean square error / bound; coverage: share of 95 % intervals that contain the true value"
)
LONGEST_MESSAGE = 120
GREEN, YELLOW = 32, 33


def disturbance_of(scenario: Scenario) -> str:
    """Return the disturbance of a scenario with its size, or ``none``."""
    return f"{scenario.disturbance.kind} {scenario.disturbance.size:g}" if scenario.disturbance else "none"


def described(scenario: Scenario) -> str:
    """Describe a scenario in a few words."""
    text = f"{scenario.label} {scenario.snr_db:g} dB {scenario.initial_state}"
    return f"{text}, {disturbance_of(scenario)}" if scenario.disturbance else text


def cell_table(cell: Cell, stored: StoredCell) -> str:
    """Tabulate the scores of one cell: the identifiable quantities first, below them those that the prior decides."""
    scenario = cell.scenario
    head = f"{cell.label} on {scenario.label}, {scenario.snr_db:g} dB"
    head += f", disturbance {disturbance_of(scenario)}" if scenario.disturbance else ""
    head += f", initial state {scenario.initial_state}, {stored.n_ok}/{len(stored.rows)} ok"
    names = [q.name for q in scenario.make_system().quantities if q.name + ERROR in stored.summary]
    known = [name for name in names if stored.identifiable.get(name, True)]
    rows = [_quantity_row(stored, name) for name in known]
    rows += [_row(label, stored.summary[metric], "-") for metric, label in RMSES.items() if metric in stored.summary]
    blocks = [wrapped(head), table(rows, HEADINGS)]
    if free := [name for name in names if name not in known]:
        rows = [[*_quantity_row(stored, name), percent(stored.prior_share.get(name, math.nan))] for name in free]
        blocks.append(f"{wrapped(NOT_IDENTIFIABLE)}\n{table(rows, [*HEADINGS, 'prior %'])}")
    text = verdict(stored)
    lines = [coloured(wrapped(text), GREEN if text == GOOD else YELLOW)]
    lines += [wrapped(f"{n} x {status}: {message}", "    ", "  ") for (status, message), n in failures(stored).items()]
    seconds = [row.wall_s for row in stored.rows if math.isfinite(row.wall_s)]
    if seconds:
        lines.append(f"median time per fit: {time_text(median_high(seconds))} (start-up of a batch included)")
    lines += [wrapped(sentence) for sentence in [*_searches(stored), LEGEND]]
    return "\n\n".join([*blocks, "\n".join(lines)])


def failures(stored: StoredCell) -> Counter[tuple[str, str]]:
    """Count the failed fits of a cell by status and message."""
    return Counter(
        (row.status.value, row.message[:LONGEST_MESSAGE]) for row in stored.rows if row.status is not Status.OK
    )


def _quantity_row(stored: StoredCell, name: str) -> list[str]:
    coverage = stored.summary.get(f"{name}_coverage_95", {}).get("mean", math.nan)
    return _row(f"{readable(name)} %", stored.summary[name + ERROR], percent(coverage))


def _row(label: str, line: Mapping[str, Any], coverage: str) -> list[str]:
    ends = rounded(line["median"], line["ci_low"], line["ci_high"])
    return [label, *ends, number(line["bound"]), short_excess(line["excess"]), coverage]


def _searches(stored: StoredCell) -> list[str]:
    """Describe the searches of a cell: how many starting points reached the best objective, and the gradient there."""
    fits = [row.scores for row in stored.rows]
    searches = [fit for fit in fits if fit.get("starts", 1.0) > 1.0]
    sentences = []
    if searches:
        starts, best = (sum(fit[name] for fit in searches) for name in ("starts", "starts_at_best"))
        alone = sum(fit["starts_at_best"] == 1 for fit in searches)
        rare = f"; in {alone} of {len(searches)} fits only one starting point reached it" if alone else ""
        sentences.append(f"search: {best:.0f} of {starts:.0f} starting points reached the best objective{rare}")
    gradients = [fit["certificate"] for fit in fits if "certificate" in fit]
    if gradients:
        sentences.append(f"convergence: normalized gradient at most {max(gradients):.1g} (0 at a minimum)")
    return sentences
