"""The leaderboard: one line a scenario, method and quantity, all scenarios in one table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.contract.estimate import Status
from bench.entrants.reference import REFERENCES
from bench.reporting.page.gather import ERROR, Gathered, Panel, decibels, label_of
from bench.reporting.page.standing import Ranking, fit_seconds, rank
from bench.reporting.page.typical import typical
from bench.reporting.page.words import heading, number, percent, seconds, title_of
from bench.reporting.tables.tables import errors_of, excess_text
from bench.store.store import StoredCell

MOST_LINES = 6000
"""More would not fit into the page; whole scenarios are left out, and it says so."""
PLACES = {"best": "best", "level": "level", "behind": "behind", "alone": "only method", "all failed": "all failed"}


@dataclass(frozen=True)
class Line:
    """A row of the leaderboard, as text."""

    tables: str
    system: str
    snr: str
    start: str
    data: str
    method: str
    quantity: str
    rms: str
    median: str
    interval: str
    bound: str
    excess: str
    place: str
    prior: str
    ok: str
    time: str

    @property
    def level(self) -> bool:
        """Whether it is the best of its rows, or cannot be told from it."""
        return self.place.startswith(("best", "level"))


@dataclass(frozen=True)
class Board:
    """The lines, and how many scenarios had no room."""

    lines: tuple[Line, ...]
    left_out: int


Rankings = dict[tuple[int, str], Ranking | None]
"""By the panel's place in the page and by metric."""


def rankings(gathered: Gathered) -> Rankings:
    """Every scenario's methods by every metric that its data decide."""
    return {(i, metric): rank(panel, metric) for i, panel in enumerate(gathered.panels) for metric in panel.ranked}


def board(gathered: Gathered, ranked: Rankings) -> Board:
    """The leaderboard of the store, tables first, as far as there is room: first for one scenario of every system."""
    panels, room = gathered.panels, MOST_LINES
    first = [i for i in typical(panels) if panels[i].experiments]
    lines: dict[int, list[Line]] = {}
    for i in [*first, *(i for i in range(len(panels)) if i not in first)]:
        own = panel_lines(panels[i], {metric: ranked.get((i, metric)) for metric in panels[i].metrics})
        if not lines or len(own) <= room:
            lines[i], room = own, room - len(own)
    return Board(tuple(line for i in sorted(lines) for line in lines[i]), len(panels) - len(lines))


def panel_lines(panel: Panel, ranked: dict[str, Ranking | None]) -> list[Line]:
    """The lines of one scenario: best first in each quantity, failures last."""
    lines = []
    for metric in panel.metrics:
        own = [cell for cell in panel.cells if metric in cell.summary]
        order = sorted(own, key=lambda cell: (_infinite(cell.summary[metric]["median"]), title_of(label_of(cell))))
        lines += [_line(panel, cell, metric, ranked.get(metric)) for cell in order]
    return lines


def root_mean_square(errors: np.ndarray) -> float:
    """Of the errors of the successful fits, as in × bound; NaN where none succeeded."""
    good = errors[np.isfinite(errors)]
    with np.errstate(over="ignore"):  # an infinite one says as much
        return float(np.sqrt(np.mean(good**2))) if good.size else math.nan


def _infinite(value: float) -> float:
    return math.inf if math.isnan(value) else value


def _line(panel: Panel, cell: StoredCell, metric: str, ranking: Ranking | None) -> Line:
    summary, label = cell.summary[metric], label_of(cell)
    low, high, excess = summary["ci_low"], summary["ci_high"], summary["excess"]
    known = math.isfinite(low) and not math.isnan(high)
    unsupported = cell.n_ok == 0 and cell.status is Status.UNSUPPORTED
    return Line(
        tables=", ".join(one.short for one in panel.experiments) or "–",
        system=panel.system,
        snr=decibels(panel.snr_db),
        start=panel.told,
        data=panel.kind,
        method=title_of(label),
        quantity=heading(metric),
        rms=number(root_mean_square(errors_of(cell, metric))),
        median="–" if unsupported else number(summary["median"]),
        interval=f"{number(low)} to {number(high)}" if known else "–",
        bound=number(summary["bound"]) if math.isfinite(summary["bound"]) else "–",
        excess=excess_text(excess) if math.isfinite(excess) else "–",
        place=_place(cell, ranking, label),
        prior="–"
        if metric == "rmse" or label == "prior"
        else percent(panel.prior_share.get(metric.removesuffix(ERROR), math.nan)),
        ok=f"{cell.n_ok}/{len(cell.rows)}",
        time=seconds(fit_seconds(cell)),
    )


def _place(cell: StoredCell, ranking: Ranking | None, label: str) -> str:
    if cell.cell.get("method") in REFERENCES:
        return "reference"
    if cell.status is Status.UNSUPPORTED and cell.n_ok == 0:
        return "unsupported"
    if cell.n_ok == 0:
        return f"failed: {cell.status.value.replace('_', ' ')}"
    if ranking is None:
        return "not ranked"
    if label in ranking.weak:
        return "undecided (fewer data)"
    return PLACES.get(ranking.places.get(label, ""), "–")


def options(lines: Sequence[Line], name: str) -> list[str]:
    """What a filter offers: the values of a column in order; numbers by size."""
    found = list(dict.fromkeys(str(getattr(line, name)) for line in lines))
    try:
        return sorted(found, key=float, reverse=True)
    except ValueError:
        return found if name in ("quantity", "system", "data") else sorted(found, key=str.casefold)
