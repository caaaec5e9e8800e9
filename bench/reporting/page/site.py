"""``python -m bench report``: the results as a folder of pages that opens from a disk, without network or server.

From stored cells, their arrays and a folder of results (tables, figures) alone, of which it holds copies; nothing is
computed anew but ranks. The same store gives the same bytes.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import Any

from bench.reporting.frame import group
from bench.reporting.grid import rendered
from bench.reporting.labels import in_order, title
from bench.reporting.page import board, cards, describe, elsewhere, home, origin, told
from bench.reporting.page.addresses import scenario_slugs, slugs
from bench.reporting.page.documents import FILES, ResultsDocument, documents
from bench.reporting.page.pictures import PagePicture, pictures
from bench.reporting.page.reading import ScenarioPanel, StoreReading, decibels, read
from bench.reporting.page.scenario_data import scenario_data
from bench.reporting.page.situations import Advice, advise
from bench.reporting.page.sketch import sketch
from bench.reporting.page.standing import fit_seconds
from bench.reporting.page.untold import untold
from bench.reporting.page.words import heading, number, percent, quantity, seconds, unbroken
from bench.store.store import Store

STATIC = ("site.css", "site.js", "charts.js", "home.js", "board.js", "compare.js", "scenario.js")
BUDGETS = (0.001, 0.01, 0.1, 1.0, 10.0)
"""Seconds a fit that the leaderboard offers as a limit."""
MEASURED = "table11"
"""The document of methods on real records."""


@dataclass(frozen=True, eq=False)
class Site:
    """All that pages are made of; ``results`` is the folder of tables and figures."""

    store: Store
    results: Path
    reading: StoreReading

    @property
    def panels(self) -> tuple[ScenarioPanel, ...]:
        return self.reading.panels

    @cached_property
    def scenarios(self) -> list[str]:
        """The address of each scenario."""
        return scenario_slugs(self.panels)

    @cached_property
    def words(self) -> list[str]:
        """The title of each scenario."""
        return describe.distinct_words(self.panels)

    @cached_property
    def labels(self) -> list[str]:
        """Methods, variants and reference rows that are stored, and methods that are registered."""
        stored = [result.label for panel in self.panels for result in panel.results]
        return in_order([*stored, *(card.name for card in self.cards)])

    @cached_property
    def methods(self) -> Mapping[str, str]:
        """The address of each label."""
        return slugs(self.labels)

    @cached_property
    def systems(self) -> Mapping[str, list[int]]:
        """The scenarios of each system."""
        return group(range(len(self.panels)), lambda i: self.panels[i].facts.system)

    @cached_property
    def system_slugs(self) -> Mapping[str, str]:
        return slugs(list(self.systems))

    @cached_property
    def rankings(self) -> board.Rankings:
        return board.rankings(self.panels)

    @cached_property
    def cards(self) -> list[cards.Description]:
        return cards.cards()

    @cached_property
    def metrics(self) -> list[str]:
        """The quantities of all scenarios, displacement last."""
        names = dict.fromkeys(metric for panel in self.panels for metric in panel.metrics)
        return [*(name for name in names if name != "rmse"), *(["rmse"] if "rmse" in names else [])]

    @cached_property
    def atlas(self) -> tuple[dict[str, Any], int]:
        return elsewhere.atlas_records(self.results)

    @cached_property
    def advice(self) -> list[Advice]:
        return advise(self.panels, elsewhere.unsteady(self.atlas[0]))

    @cached_property
    def documents(self) -> list[ResultsDocument]:
        return documents(self.results)

    @cached_property
    def pictures(self) -> list[PagePicture]:
        return pictures(self.results / "figures")


def site_files(store: Store, results: Path) -> Iterator[tuple[str, bytes]]:
    """Yield every file of the site by its path in the folder; raises InputError for a store that cannot be shown."""
    site = Site(store, results, read(store))
    yield from _assets()
    for picture in site.pictures:
        yield f"figures/{picture.name}.png", picture.data
    for document in site.documents:
        yield from ((f"{FILES}/{name}", (results / name).read_bytes()) for name in document.files)
    for path, call, value in _data(site):
        yield path, f"bench.{call}({_json(value)});\n".encode()
    for path, text in _pages(site):
        yield path, text.encode()


def _json(value: Any) -> str:
    return json.dumps(value, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def _assets() -> Iterator[tuple[str, bytes]]:
    folder = files("bench.reporting.page")
    for name in STATIC:
        yield f"assets/{name}", folder.joinpath("static", name).read_bytes()
    yield "assets/base.css", folder.joinpath("report.css").read_bytes()
    for item in sorted(folder.joinpath("vendor").iterdir(), key=lambda one: one.name):
        yield f"assets/vendor/{item.name}", item.read_bytes()


def _data(site: Site) -> Iterator[tuple[str, str, Any]]:
    """The data files: path, the function that they call, and what they hand it."""
    yield "data/index.js", "index", index(site)
    places, metrics = ({name: i for i, name in enumerate(names)} for names in (site.labels, site.metrics))
    for system, own in site.systems.items():
        blocks = [block for i in own for block in board.blocks(i, site.panels[i], site.rankings, places, metrics)]
        slug = site.system_slugs[system]
        yield f"data/board/{slug}.js", "board", {"system": slug, "blocks": blocks}
    for slug, panel in zip(site.scenarios, site.panels, strict=True):
        yield f"data/scenario/{slug}.js", "scenario", {"slug": slug, **scenario_data(site.store, panel)}
    if site.advice:
        yield "data/home.js", "home", home.forest(site.advice[0])


def index(site: Site) -> dict[str, Any]:
    """What every choice of the leaderboard is made of."""
    systems = list(site.systems)
    return {
        "shared": board.SHARED,
        "columns": board.COLUMNS,
        "standings": board.STANDINGS,
        "methods": [[label, title(label), site.methods[label]] for label in site.labels],
        "quantities": [heading(metric) for metric in site.metrics],
        "metrics": site.metrics,
        "systems": [[name, site.system_slugs[name], describe.system_words(site.panels[own[0]].facts)]
                    for name, own in site.systems.items()],
        "scenarios": [
            [slug, systems.index(p.facts.system), decibels(p.facts.snr_db), p.facts.initial_state, p.kind,
             ", ".join(one.said for one in p.experiments), words]
            for slug, words, p in zip(site.scenarios, site.words, site.panels, strict=True)
        ],
        "budgets": BUDGETS,
        "first": first_choice(site),
    }  # fmt: skip


def first_choice(site: Site) -> dict[str, str]:
    """What the leaderboard shows at first: a scenario of the first screen's first situation, at a middle noise."""
    own = list(site.advice[0].panels) if site.advice else list(site.panels[:1])
    level = told.usual(own)
    panel = next(p for p in own if p.facts.snr_db == level)
    chosen = {"system": panel.facts.system, "snr": decibels(panel.facts.snr_db), "start": panel.facts.initial_state}
    return {**chosen, "data": panel.kind, **({"quantity": heading(panel.ranked[0])} if panel.ranked else {})}


def _pages(site: Site) -> Iterator[tuple[str, str]]:
    """The pages by path."""
    yield _page(site, "index.html", "home", **home_values(site))
    yield _page(site, "own.html", "own", measured=next((d for d in site.documents if d.name == MEASURED), None))
    yield _page(site, "leaderboard.html", "leaderboard")
    yield _page(site, "systems.html", "systems", systems=[system_values(site, name) for name in site.systems])
    yield _page(site, "methods.html", "methods", cards=site.cards)
    yield _page(site, "scenarios.html", "scenarios")
    yield _page(site, "results.html", "results")
    yield _page(site, "figures.html", "figures")
    yield _page(site, "provenance.html", "provenance", **provenance_values(site))
    for name in site.systems:
        yield _page(site, f"systems/{site.system_slugs[name]}.html", "system", **system_values(site, name))
    for label in site.labels:
        yield _page(site, f"methods/{site.methods[label]}.html", "method", **method_values(site, label))
    for i, slug in enumerate(site.scenarios):
        yield _page(site, f"scenarios/{slug}.html", "scenario", **scenario_values(site, i))
    for one in site.advice:
        yield _page(site, f"situations/{one.situation.name}.html", "situation", **situation_values(site, one))
    for document in site.documents:
        yield _page(site, document.href, "document", document=document)


def _page(site: Site, path: str, template: str, **values: Any) -> tuple[str, str]:
    """A page of a template; every text is escaped, and only the site's own scripts may run."""
    shared = {"site": site, "root": "../" * path.count("/"), "path": path, "title_of": title, "describe": describe}
    shared |= {
        "decibels": decibels,
        "number": number,
        "percent": percent,
        "seconds": seconds,
        "share": home.share,
        "unbroken": unbroken,
        "order": order,
    }
    return path, rendered(f"page/templates/{template}.html.j2", **shared, **values)


def order(value: float) -> str:
    """What a cell of a table sorts by; last where there is nothing."""
    return f"{value:.4g}" if math.isfinite(value) else "1e300"


def home_values(site: Site) -> dict[str, Any]:
    """The first screen."""
    atlas, points = site.atlas
    rows = home.rows(site.advice, atlas, points, site.results)
    first = site.advice[0] if site.advice else None
    panels = first.panels if first else site.panels
    best = first.advised[0] if first and not first.hopeless else None
    return {
        "rows": rows, "first": first, "best": best, "one_in": home.one_in(best.risk_at_most) if best else "",
        "noise": told.noise(panels), "untold": untold(panels[0]),
        "ranked": list(map(quantity, told.ranked(panels[0]))),
        "basis": home.basis_of(panels), "counts": counts(site),
    }  # fmt: skip


def counts(site: Site) -> dict[str, int]:
    """How much there is."""
    methods = {result.method for panel in site.panels for result in panel.methods}
    fits = sum(result.n for panel in site.panels for result in panel.methods)
    return {"methods": len(methods), "scenarios": len(site.panels), "systems": len(site.systems), "fits": fits}


def system_values(site: Site, name: str) -> dict[str, Any]:
    """A system: what it is, its parameters, its scenarios, and the prior's share in what is told."""
    own = site.systems[name]
    facts = site.panels[own[0]].facts
    model = facts.known_model
    shares: dict[str, str] = {}
    for i in own:
        for parameter, part in site.panels[i].prior_share.items():
            shares.setdefault(quantity(f"{parameter}_error_pct"), percent(part))
    return {
        "name": name, "facts": facts, "slug": site.system_slugs[name], "words": describe.system_words(facts),
        "sketch": sketch(facts), "scenarios": own,
        "about": (type(model).__doc__ or "").strip().split("\n")[0] if model else "", "shares": shares,
    }  # fmt: skip


def method_values(site: Site, label: str) -> dict[str, Any]:
    """A method or variant: its card, and what it did in each situation and scenario."""
    found = {p_i: cell for p_i, panel in enumerate(site.panels) for cell in panel.results if cell.label == label}
    name = next((cell.method for cell in found.values()), label)
    card = next((card for card in site.cards if card.name == name), None)
    return {
        "label": label,
        "name": name,
        "card": card,
        "cells": found,
        "standings": standings(site, label),
        "of": pooled,
    }


def pooled(cell: Any, panel: ScenarioPanel) -> float:
    """A cell in a number: the median over the quantities that the data tell of the error over the bound."""
    return board.middle([cell.excess(metric) for metric in panel.ranked if metric in cell.summary])


def standings(site: Site, label: str) -> list[tuple[Advice, str, Any]]:
    """In each situation where a method ran: what is said of it there."""
    found = []
    for one in site.advice:
        parts = {"advised": one.advised, "behind": one.behind, "runs away": one.fragile, "ran on a part": one.partial}
        for said, records in parts.items():
            found += [(one, said, record) for record in records if record.label == label]
    return found


def scenario_values(site: Site, place: int) -> dict[str, Any]:
    """A scenario: what was told, and a line a method."""
    panel = site.panels[place]
    order = sorted(panel.results, key=lambda cell: (cell.is_reference, _last(pooled(cell, panel)), cell.label))
    lines = [(cell, pooled(cell, panel), fit_seconds(cell), standing(site, place, cell)) for cell in order]
    return {
        "panel": panel, "slug": site.scenarios[place], "words": site.words[place], "told": describe.told(panel),
        "again": describe.again(panel), "sketch": sketch(panel.facts), "lines": lines, "untold": untold(panel),
        "situations": [one for one in site.advice if panel in one.panels],
    }  # fmt: skip


def _last(value: float) -> float:
    return math.inf if math.isnan(value) else value


def standing(site: Site, place: int, cell: Any) -> str:
    """In how many of the quantities that the data tell a method is best or level with the best."""
    panel = site.panels[place]
    if cell.is_reference:
        return "reference"
    named = [
        board.standing_of(cell, site.rankings.get((place, metric))) for metric in panel.ranked if metric in cell.summary
    ]
    if not named or named[0] in ("unsupported", "failed"):
        return named[0] if named else "–"
    return f"{sum(own in ('best', 'level', 'only method') for own in named)} of {len(named)}"


def situation_values(site: Site, one: Advice) -> dict[str, Any]:
    """A situation: every method's record, and the scenarios behind it."""
    parts = (
        ("Advised, fastest first", one.advised), ("Further from the bound", one.behind),
        ("Not advised: gross errors here or in the atlas", one.fragile),
        ("Ran on a part of the scenarios only", one.partial),
    )  # fmt: skip
    places = [i for i, panel in enumerate(site.panels) if panel in one.panels]
    return {
        "advice": one,
        "groups": parts,
        "places": places,
        "error": home.error_text,
        "risk": home.risk_text,
        "needs": home.needs,
    }


def provenance_values(site: Site) -> dict[str, Any]:
    """Where the cells come from, and what failed."""
    results: Sequence[Any] = site.reading.results
    return {
        "origin": origin.origin(results), "failures": origin.failures(results),
        "unsupported": origin.unsupported(results),
        "hidden": site.reading.hidden,
    }  # fmt: skip
