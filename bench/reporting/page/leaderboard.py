"""The leaderboard: one line a scenario, method and quantity, all scenarios in one table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.contract.estimate import Status
from bench.reporting.frame import ERROR, Result
from bench.reporting.page.reading import Panel, Reading, decibels
from bench.reporting.page.standing import Ranking, fit_seconds, rank
from bench.reporting.page.typical import typical
from bench.reporting.page.words import heading, number, percent, seconds
from bench.reporting.rounding import excess_text

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
class Leaderboard:
    """The lines, and how many scenarios had no room."""

    lines: tuple[Line, ...]
    left_out: int


Rankings = dict[tuple[int, str], Ranking | None]
"""By the panel's place in the page and by metric."""


def rankings(reading: Reading) -> Rankings:
    """Every scenario's methods by every metric that its data decide."""
    return {(i, metric): rank(panel, metric) for i, panel in enumerate(reading.panels) for metric in panel.ranked}


def leaderboard(reading: Reading, ranked: Rankings) -> Leaderboard:
    """The leaderboard of the store, tables first, as far as there is room: first for one scenario of every system."""
    panels, room = reading.panels, MOST_LINES
    first = [i for i in typical(panels) if panels[i].experiments]
    lines: dict[int, list[Line]] = {}
    for i in [*first, *(i for i in range(len(panels)) if i not in first)]:
        own = panel_lines(panels[i], {metric: ranked.get((i, metric)) for metric in panels[i].metrics})
        if not lines or len(own) <= room:
            lines[i], room = own, room - len(own)
    return Leaderboard(tuple(line for i in sorted(lines) for line in lines[i]), len(panels) - len(lines))


def panel_lines(panel: Panel, ranked: dict[str, Ranking | None]) -> list[Line]:
    """The lines of one scenario: best first in each quantity, failures last."""
    lines = []
    for metric in panel.metrics:
        own = [result for result in panel.results if metric in result.summary]
        order = sorted(own, key=lambda result: (_infinite(result.statistic(metric, "median")), result.title))
        lines += [_line(panel, result, metric, ranked.get(metric)) for result in order]
    return lines


def root_mean_square(errors: np.ndarray) -> float:
    """Of the errors of the successful fits, as in × bound; NaN where none succeeded."""
    good = errors[np.isfinite(errors)]
    with np.errstate(over="ignore"):  # an infinite one says as much
        return float(np.sqrt(np.mean(good**2))) if good.size else math.nan


def _infinite(value: float) -> float:
    return math.inf if math.isnan(value) else value


def _line(panel: Panel, result: Result, metric: str, ranking: Ranking | None) -> Line:
    low, high, bound, excess = (result.statistic(metric, name) for name in ("ci_low", "ci_high", "bound", "excess"))
    known = math.isfinite(low) and not math.isnan(high)
    untold = metric == "rmse" or result.label == "prior"
    share = math.nan if untold else panel.prior_share.get(metric.removesuffix(ERROR), math.nan)
    return Line(
        tables=", ".join(one.short for one in panel.experiments) or "–",
        system=result.system,
        snr=decibels(result.snr_db),
        start=result.initial_state,
        data=panel.kind,
        method=result.title,
        quantity=heading(metric),
        rms=number(root_mean_square(result.errors(metric))),
        median="–" if _unsupported(result) else number(result.statistic(metric, "median")),
        interval=f"{number(low)} to {number(high)}" if known else "–",
        bound=number(bound) if math.isfinite(bound) else "–",
        excess=excess_text(excess) if math.isfinite(excess) else "–",
        place=_place(result, ranking),
        prior=percent(share),
        ok=f"{result.n_ok}/{result.n}",
        time=seconds(fit_seconds(result)),
    )


def _unsupported(result: Result) -> bool:
    return result.status is Status.UNSUPPORTED


def _place(result: Result, ranking: Ranking | None) -> str:
    if result.is_reference:
        return "reference"
    if _unsupported(result):
        return "unsupported"
    if result.n_ok == 0:
        return f"failed: {result.status.value.replace('_', ' ')}"
    if ranking is None:
        return "not ranked"
    if result.label in ranking.weak:
        return "undecided (fewer data)"
    return PLACES.get(ranking.places.get(result.label, ""), "–")


def options(lines: Sequence[Line], name: str) -> list[str]:
    """What a filter offers: the values of a column in order; numbers by size."""
    found = list(dict.fromkeys(str(getattr(line, name)) for line in lines))
    try:
        return sorted(found, key=float, reverse=True)
    except ValueError:
        return found if name in ("quantity", "system", "data") else sorted(found, key=str.casefold)
