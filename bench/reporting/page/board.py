"""Data of the leaderboard: one line per scenario, method and quantity, as columns of sorted texts."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np

from bench.contract.estimate import Status
from bench.reporting.frame import Result
from bench.reporting.page.charts import scenario_data
from bench.reporting.page.reading import ScenarioPanel
from bench.reporting.page.words import USUAL_DB, decibels, heading, system_words
from bench.reporting.ranking import first_tier, median_time
from bench.reporting.rounding import number, time_text
from bench.scoring.summary import outlier_fits
from bench.store.stored_cell import unmarked

STANDINGS = ("tied", "worse", "reference", "failed")
"""Values of the column "Standing", in the order in which it is sorted."""
BY_SCENARIO = ("System", "SNR", "Initial state", "Data")
"""Columns of the scenario."""
HIDDEN = ("Bound", *BY_SCENARIO)
"""Columns that are hidden by default."""


class Line(NamedTuple):
    """The errors of a method in one quantity of a scenario, and the scenario's first tier."""

    place: int
    panel: ScenarioPanel
    metric: str
    result: Result
    tier: frozenset[Result]


def data_files(site: Any) -> Iterator[tuple[str, bytes]]:
    """Yield the data that the scripts of the pages load: the path in the site, and a call of a function."""
    yield "data/board.js", called("board", board(site.panels, site.methods))
    for panel in site.panels:
        yield f"scenarios/{panel.slug}.js", called("scenario", {"slug": panel.slug, **scenario_data(panel)})


def called(function: str, value: Any) -> bytes:
    """Return a script that calls a function of the page with a value."""
    text = json.dumps(value, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return f"bench.{function}({text});\n".encode()


def board(panels: Sequence[ScenarioPanel], methods: Mapping[str, str]) -> list[dict[str, Any]]:
    """Return the columns of the leaderboard, without quantities that are not identifiable.

    Args:
        panels: The scenarios.
        methods: Addresses of the methods, by label.
    """
    lines = [
        Line(i, panel, metric, result, tier)
        for i, panel in enumerate(panels)
        for metric in panel.ranked
        for tier in [first_tier(panel.results, [metric])]
        for result in panel.results
        if metric in result.summary and result.status is not Status.UNSUPPORTED
    ]
    chosen = [choices(panel) for panel in panels]
    return [
        column("Method", lines, lambda line: (line.result.title, line.result.label), itemgetter(0),
               lambda value: f"methods/{methods[unmarked(value[1])]}.html"),
        column("Error of", lines, lambda line: heading(line.metric)),
        column("× bound", lines, statistic("excess"), number),
        column("Standing", lines, lambda line: STANDINGS.index(standing(line)), STANDINGS.__getitem__),
        column("Bound", lines, lambda line: short(line.result.bound(line.metric), 3), number),
        column("Median", lines, statistic("median"), number),
        column("95 %", lines, interval, lambda ends: f"{number(ends[0])} to {number(ends[1])}"),
        column("Outliers", lines, outlier_share, lambda share: f"{share:g} %"),
        column("Fits ok", lines, fits, lambda counts: f"{counts[1]}/{counts[2]}"),
        column("Time per fit", lines, lambda line: short(median_time([line.result]), 2), time_text),
        column("Scenario", lines, lambda line: line.place, lambda place: panels[place].title,
               lambda place: f"scenarios/{panels[place].slug}.html"),
        *(column(name, lines, partial(choice_key, chosen, name), itemgetter(1)) for name in BY_SCENARIO),
    ]  # fmt: skip


def choice_key(chosen: Sequence[Mapping[str, str]], name: str, line: Line) -> tuple[float, str]:
    """Return the sort key of a line in a column of the scenario: noise levels are numbers, the rest are texts."""
    text = chosen[line.place][name]
    return float(text.split()[0]) if name == "SNR" else 0.0, text


def column(
    name: str, lines: Sequence[Line], value: Callable[[Any], Any], text: Callable[[Any], str] = str, link: Any = None
) -> dict[str, Any]:  # fmt: skip
    """Return a column: its distinct texts in sorted order, and an index into them per line.

    Args:
        name: Title of the column.
        lines: The lines.
        value: Sort key of a line; None comes last.
        text: Text of a sort key.
        link: Address of a sort key, if the texts are links.
    """
    values = [value(line) for line in lines]
    order = sorted(set(values), key=lambda key: (key is None, key))
    places = {key: i for i, key in enumerate(order)}
    links = {"links": [link(key) for key in order]} if link else {}
    texts = ["–" if key is None else text(key) for key in order]
    return {"title": name, "values": texts, **links, "codes": [places[key] for key in values]}


def first_choice(panels: Sequence[ScenarioPanel]) -> dict[str, str]:
    """Return the first view of the leaderboard: a scenario at the usual noise, and an identifiable quantity."""
    panel = min(panels, key=lambda panel: abs(panel.facts.snr_db - USUAL_DB))
    return {**choices(panel), **({"Error of": heading(panel.ranked[0])} if panel.ranked else {})}


def choices(panel: ScenarioPanel) -> dict[str, str]:
    """Return the filters of the leaderboard that select a scenario."""
    facts = panel.facts
    system = f"{facts.system}: {system_words(facts)}"
    return {
        "System": system, "SNR": f"{decibels(facts.snr_db)} dB", "Initial state": facts.initial_state,
        "Data": panel.kind,
    }  # fmt: skip


def statistic(name: str) -> Callable[[Line], float | None]:
    """Return a function that reads a statistic of the summary of a line."""
    return lambda line: short(line.result.statistic(line.metric, name), 3)


def interval(line: Line) -> tuple[float, float] | None:
    """Return the 95 % interval of the median error."""
    low, high = (short(line.result.statistic(line.metric, name), 2) for name in ("ci_low", "ci_high"))
    return None if low is None or high is None else (low, high)


def outlier_share(line: Line) -> float | None:
    """Return the share of outlier fits (%)."""
    errors = line.result.errors(line.metric)
    bound = line.result.bound(line.metric)
    return short(100 * float(np.mean(outlier_fits(errors, bound))), 2) if errors.size else None


def fits(line: Line) -> tuple[float, int, int]:
    """Return the successful fits, with a sort key that puts the largest share first."""
    return -line.result.n_ok / max(line.result.n, 1), line.result.n_ok, line.result.n


def short(value: float, digits: int = 4) -> float | None:
    """Round to significant digits; None if not finite."""
    return float(f"{value:.{digits}g}") if math.isfinite(value) else None


def standing(line: Line) -> str:
    """Return the standing of a line, one of :data:`STANDINGS`."""
    if line.result.is_reference:
        return "reference"
    if line.result.n_ok == 0:
        return "failed"
    return "tied" if line.result in line.tier else "worse"
