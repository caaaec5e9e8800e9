"""The leaderboard: a line a scenario, method and quantity; its columns as texts in the order in which they sort."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np

from bench.contract.estimate import Status
from bench.reporting.frame import Result
from bench.reporting.page.charts import forest, scenario_data
from bench.reporting.page.reading import ScenarioPanel
from bench.reporting.page.words import USUAL_DB, decibels, heading, number, seconds, system_words
from bench.reporting.ranking import first_tier, median_time
from bench.scoring.summary import outlier_fits
from bench.store.stored import unmarked

STANDINGS = ("first tier", "behind", "reference", "failed")
"""In the order in which a board is sorted at first."""
BY_SCENARIO = ("System", "SNR", "Initial state", "Data")
"""Columns that all lines of a scenario share."""
HIDDEN = ("Bound", *BY_SCENARIO)
"""Columns that are not shown at first."""


class Line(NamedTuple):
    """A method's errors in one quantity of a scenario; ``tier`` is the first."""

    place: int
    panel: ScenarioPanel
    metric: str
    result: Result
    tier: frozenset[Result]


def data_files(site: Any) -> Iterator[tuple[str, bytes]]:
    """What the pages' scripts load: the path in the site, and a call of one of their functions."""
    yield "data/board.js", called("board", board(site.panels, site.methods))
    for panel in site.panels:
        yield f"scenarios/{panel.slug}.js", called("scenario", {"slug": panel.slug, **scenario_data(panel)})
    if site.advice:
        yield "data/home.js", called("draw", {"forest": forest(site.advice[0])})


def called(function: str, value: Any) -> bytes:
    """A script that hands a value to a function of the page."""
    text = json.dumps(value, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return f"bench.{function}({text});\n".encode()


def board(panels: Sequence[ScenarioPanel], methods: Mapping[str, str]) -> list[dict[str, Any]]:
    """Its columns, with the addresses of methods; quantities that a scenario's data do not tell are left out."""
    asked = [(i, panel, metric) for i, panel in enumerate(panels) for metric in panel.ranked]
    tiers = [(*own, first_tier(own[1].results, [own[2]])) for own in asked]
    lines = [
        Line(i, panel, metric, result, tier)
        for i, panel, metric, tier in tiers
        for result in panel.results
        if metric in result.summary and result.status is not Status.UNSUPPORTED
    ]
    used = [panels[i] for i in sorted({line.place for line in lines})]
    return [
        column("Method", lines, lambda line: (line.result.title, line.result.label), lambda own: own[0],
               lambda own: f"methods/{methods[unmarked(own[1])]}.html"),
        column("Error of", lines, lambda line: heading(line.metric)),
        column("× bound", lines, statistic("excess"), number),
        column("Standing", lines, lambda line: STANDINGS.index(standing(line)), STANDINGS.__getitem__),
        column("Bound", lines, lambda line: short(line.result.bound(line.metric), 3), number),
        column("Median", lines, statistic("median"), number),
        column("95 %", lines, interval, lambda own: f"{number(own[0])} to {number(own[1])}"),
        column("Gross", lines, gross_share, lambda own: f"{own:g} %"),
        column("Fits ok", lines, fits, lambda own: f"{own[1]}/{own[2]}"),
        column("Time per fit", lines, lambda line: short(median_time([line.result]), 2), seconds),
        column("Scenario", lines, lambda line: line.place, lambda place: panels[place].title,
               lambda place: f"scenarios/{panels[place].slug}.html"),
        *(column(name, list(map(choices, used)), itemgetter(name), by="Scenario") for name in BY_SCENARIO),
    ]  # fmt: skip


def column(
    name: str, items: Sequence[Any], value: Callable[[Any], Any], text: Callable[[Any], str] = str, link: Any = None,
    by: str = "",
) -> dict[str, Any]:  # fmt: skip
    """Its texts, sorted by what they show, and their places for each line, or for each text of the column ``by``."""
    values = [value(item) for item in items]
    order = sorted(set(values), key=lambda own: (own is None, own))
    places = {own: i for i, own in enumerate(order)}
    found = {"title": name, "values": ["–" if own is None else text(own) for own in order], "by": by}
    links = {"links": [link(own) for own in order]} if link else {}
    return {**found, **links, "codes": [places[own] for own in values]}


def first_choice(panels: Sequence[ScenarioPanel]) -> dict[str, str]:
    """What the leaderboard shows at first: one of some scenarios at the usual noise, and a quantity that is told."""
    panel = min(panels, key=lambda one: abs(one.facts.snr_db - USUAL_DB))
    return {**choices(panel), **({"Error of": heading(panel.ranked[0])} if panel.ranked else {})}


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
    low, high = (short(line.result.statistic(line.metric, name), 2) for name in ("ci_low", "ci_high"))
    return None if low is None or high is None else (low, high)


def gross_share(line: Line) -> float | None:
    """The share of gross errors (%)."""
    errors = line.result.errors(line.metric)
    bound = line.result.bound(line.metric)
    return short(100 * float(np.mean(outlier_fits(errors, bound))), 2) if errors.size else None


def fits(line: Line) -> tuple[float, int, int]:
    """Fits that returned an answer, most first."""
    return -line.result.n_ok / max(line.result.n, 1), line.result.n_ok, line.result.n


def short(value: float, digits: int = 4) -> float | None:
    """So many significant digits; None for what is not finite."""
    return float(f"{value:.{digits}g}") if math.isfinite(value) else None


def standing(line: Line) -> str:
    """One of :data:`STANDINGS`."""
    if line.result.is_reference:
        return "reference"
    if line.result.n_ok == 0:
        return "failed"
    return "first tier" if line.result in line.tier else "behind"
