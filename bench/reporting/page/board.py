"""The leaderboard: a line a scenario, method and quantity; its columns as texts in the order in which they sort."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from bench.contract.estimate import Status
from bench.reporting.frame import ERROR, Result
from bench.reporting.page.charts import forest, scenario_data
from bench.reporting.page.describe import system_words
from bench.reporting.page.reading import ScenarioPanel, decibels
from bench.reporting.page.words import heading, number, seconds
from bench.reporting.ranking import first_tier, median_time
from bench.scoring.summary import gross

STANDINGS = ("first tier", "behind", "not ranked", "reference", "failed", "unsupported")
"""In the order in which a board is sorted at first."""
HIDDEN = ("Bound", "Prior", "System", "SNR", "Initial state", "Data")
"""Columns that are not shown at first."""
FirstTiers = Mapping[tuple[int, str], frozenset[Result]]
"""By the scenario's place and by metric, the methods that nothing tells from the best."""


class Line(NamedTuple):
    """What a line is about; ``tier``, the first, is None of a quantity that the data do not decide."""

    place: int
    panel: ScenarioPanel
    metric: str
    result: Result
    tier: frozenset[Result] | None


def first_tiers(panels: Sequence[ScenarioPanel]) -> FirstTiers:
    """Of every scenario and metric that its data decide."""
    return {
        (i, metric): first_tier(panel.results, [metric]) for i, panel in enumerate(panels) for metric in panel.ranked
    }


def data_files(site: Any) -> Iterator[tuple[str, bytes]]:
    """What the pages' scripts load: the path in the site, and a call of one of their functions."""
    whole = board(site.panels, site.first_tiers, site.words, site.scenarios, site.methods)
    yield "data/board.js", called("board", whole)
    for slug, panel in zip(site.scenarios, site.panels, strict=True):
        yield f"scenarios/{slug}.js", called("scenario", {"slug": slug, **scenario_data(panel)})
    if site.advice:
        yield "data/home.js", called("draw", {"forest": forest(site.advice[0])})


def called(function: str, value: Any) -> bytes:
    """A script that hands a value to a function of the page."""
    text = json.dumps(value, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return f"bench.{function}({text});\n".encode()


def board(
    panels: Sequence[ScenarioPanel], tiers: FirstTiers, words: Sequence[str], scenarios: Sequence[str],
    methods: Mapping[str, str],
) -> list[dict[str, Any]]:  # fmt: skip
    """Its columns, from the titles of the scenarios and the addresses of scenarios and methods."""
    lines = [
        Line(i, panel, metric, result, tiers.get((i, metric)))
        for i, panel in enumerate(panels)
        for metric in panel.metrics
        for result in panel.results
        if metric in result.summary
    ]

    def column(
        name: str, value: Callable[[Line], Any], text: Callable[[Any], str] = str, link: Any = None
    ) -> dict[str, Any]:
        values = [value(line) for line in lines]
        order = sorted(set(values), key=lambda own: (own is None, own))
        places = {own: i for i, own in enumerate(order)}
        shown = {"title": name, "values": ["–" if own is None else text(own) for own in order]}
        links = {"links": [link(own) for own in order]} if link else {}
        return {**shown, **links, "codes": [places[own] for own in values]}

    return [
        column("Method", lambda line: (line.result.title, line.result.label), lambda own: own[0],
               lambda own: f"methods/{methods[own[1]]}.html"),
        column("Error of", lambda line: heading(line.metric)),
        column("× bound", statistic("excess"), number),
        column("Standing", lambda line: STANDINGS.index(standing_of(line.result, line.tier)), STANDINGS.__getitem__),
        column("RMS error", lambda line: short(root_mean_square(line.result.errors(line.metric)), 3), number),
        column("Bound", lambda line: short(line.result.bound(line.metric), 3), number),
        column("Median", statistic("median"), number),
        column("95 %", interval, lambda own: f"{number(own[0])} to {number(own[1])}"),
        column("Gross", gross_share, lambda own: f"{own:g} %"),
        column("Prior", prior_share, lambda own: f"{own:g} %"),
        column("Fits ok", fits, lambda own: f"{own[1]}/{own[2]}"),
        column("Time per fit", lambda line: short(median_time([line.result]), 2), seconds),
        column("Scenario", lambda line: line.place, words.__getitem__,
               lambda place: f"scenarios/{scenarios[place]}.html"),
        column("System", lambda line: choices(line.panel)["System"]),
        column("SNR", lambda line: -line.panel.facts.snr_db, lambda level: f"{decibels(-level)} dB"),
        column("Initial state", lambda line: line.panel.facts.initial_state),
        column("Data", lambda line: line.panel.kind),
    ]  # fmt: skip


def choices(panel: ScenarioPanel) -> dict[str, str]:
    """A scenario as the leaderboard's choices."""
    facts = panel.facts
    system = f"{facts.system}: {system_words(facts)}"
    return {
        "System": system, "SNR": f"{decibels(facts.snr_db)} dB", "Initial state": facts.initial_state,
        "Data": panel.kind,
    }  # fmt: skip


def statistic(name: str) -> Callable[[Line], float | None]:
    """A column of one of the summary's numbers."""
    return lambda line: short(line.result.statistic(line.metric, name), 3)


def interval(line: Line) -> tuple[float, float] | None:
    """The 95 % interval of the median error."""
    low, high = (statistic(name)(line) for name in ("ci_low", "ci_high"))
    return None if low is None or high is None else (low, high)


def gross_share(line: Line) -> float | None:
    """The share of gross errors (%); None of data that the method does not take."""
    errors = line.result.errors(line.metric)
    unable = line.result.status is Status.UNSUPPORTED or not errors.size
    return None if unable else short(100 * float(np.mean(gross(errors, line.result.bound(line.metric)))), 2)


def prior_share(line: Line) -> float | None:
    """The prior's share of the precision at the bound (%)."""
    return short(100 * line.panel.prior_share.get(line.metric.removesuffix(ERROR), math.nan), 2)


def fits(line: Line) -> tuple[float, int, int]:
    """Fits that returned an answer, most first."""
    return -line.result.n_ok / max(line.result.n, 1), line.result.n_ok, line.result.n


def root_mean_square(errors: np.ndarray) -> float:
    """Of the errors of the successful fits, as in × bound; NaN where none succeeded."""
    good = errors[np.isfinite(errors)]
    with np.errstate(over="ignore"):  # an infinite one says as much
        return float(np.sqrt(np.mean(good**2))) if good.size else math.nan


def middle(values: Sequence[float]) -> float:
    """The median of the finite values; NaN where there is none."""
    finite = [value for value in values if math.isfinite(value)]
    return float(np.median(finite)) if finite else math.nan


def short(value: float, digits: int = 4) -> float | None:
    """So many significant digits; None for what is not finite."""
    return float(f"{value:.{digits}g}") if math.isfinite(value) else None


def standing_of(result: Result, tier: frozenset[Result] | None) -> str:
    """One of :data:`STANDINGS`."""
    if result.is_reference:
        return "reference"
    if result.status is Status.UNSUPPORTED:
        return "unsupported"
    if result.n_ok == 0:
        return "failed"
    if tier is None:
        return "not ranked"
    return "first tier" if result in tier else "behind"
