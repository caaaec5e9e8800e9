"""The results as pages in Markdown with their data, from which mkdocs makes a site that opens from a folder.

From stored cells, their arrays and a folder of results (tables, figures) alone; nothing is computed anew but ranks. The
same store gives the same pages. A page is a template and what of the store it is about. ``python -m bench report``
makes a site of them alone, ``docs/hooks.py`` adds them to the documentation.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import numpy as np
from markupsafe import Markup

from bench.config.files import read_yaml
from bench.entrants.registry import default_settings, load_method, missing_package, registered
from bench.errors import InputError
from bench.reporting.frame import Result, computed, group, quantity
from bench.reporting.labels import card_of, in_order, title
from bench.reporting.page import board, origin
from bench.reporting.page.elsewhere import elsewhere
from bench.reporting.page.home import method_name
from bench.reporting.page.markdown import escaped, link, rendered
from bench.reporting.page.reading import ScenarioPanel, StoreReading, read
from bench.reporting.page.situations import Advice, advice, advise
from bench.reporting.page.words import slugs
from bench.reporting.pictures.png import caption_of
from bench.reporting.tables.leaderboard import parts
from bench.store.store import Store
from bench.store.stored import unmarked

NAV = {
    "Which method?": "index.md", "Leaderboard": "leaderboard.md", "Methods": "methods.md", "Systems": "systems.md",
    "Scenarios": "scenarios.md", "Figures": "figures.md", "Can I trust these numbers?": "provenance.md",
}  # fmt: skip
"""The pages that a site of a store's results names in its head."""
MOST_NAMED = 4
"""Methods of a tier that the first screen names; of more it says how many."""
STATIC = ("static", "static/tables", "static/vega")


@dataclass(frozen=True, eq=False)
class Site:
    """All that pages are made of; ``results`` is the folder of tables and figures. Links begin at the site's root."""

    store: Store
    results: Path
    reading: StoreReading

    @property
    def panels(self) -> tuple[ScenarioPanel, ...]:
        return self.reading.panels

    @cached_property
    def methods(self) -> Mapping[str, str]:
        """The address of each method, variant and reference row that is stored, and of each registered method."""
        stored = [result for panel in self.panels for result in panel.results]
        labels = [unmarked(result.label) for result in (*stored, *self.reading.drawn)]
        return slugs(in_order([*labels, *registered()]))

    @cached_property
    def systems(self) -> Mapping[str, list[ScenarioPanel]]:
        return group(self.panels, lambda panel: panel.facts.system)

    @cached_property
    def system_slugs(self) -> Mapping[str, str]:
        return slugs(list(self.systems))

    @cached_property
    def advice(self) -> list[Advice]:
        """The rankings of the situations."""
        return advise(self.panels)

    @cached_property
    def drawn(self) -> list[Advice]:
        """The rankings of the open split, below and beyond Nyquist."""
        split = {f"One mass, drawn tests, {part}": its for part, its in parts(self.reading.drawn).items() if its}
        return [advice(words, "results/leaderboard.md", results) for words, results in split.items()]

    @cached_property
    def alone(self) -> Mapping[str, Advice]:
        """The ranking of each scenario, by its address."""
        return {p.slug: advice(p.title, f"scenarios/{p.slug}.md", p.results, [p]) for p in self.panels}

    def method(self, label: str) -> Markup:
        """The name of a method, a link where it has a page: that of the method where it was submitted."""
        slug = self.methods.get(unmarked(label))
        return link(f"/methods/{slug}.md", title(label)) if slug else escaped(title(label))

    def tier(self, one: Advice) -> Markup:
        """The methods of a first tier, or the first of them and how many more there are."""
        labels = [row.label for row in one.first_tier]
        named = Markup(", ").join(map(self.method, labels[:MOST_NAMED]))
        return named + (f" or {len(labels) - MOST_NAMED} more" if len(labels) > MOST_NAMED else "")

    def system(self, name: str, words: object = None) -> Markup:
        return link(f"/systems/{self.system_slugs[name]}.md", words or name)

    def page(self, one: Advice) -> Markup:
        """The words of a ranking, a link where its page is there."""
        there = not one.href.startswith("results/") or (self.results / Path(one.href).name).is_file()
        return link(f"/{one.href}", one.words) if there else escaped(one.words)


def site_files(store: Store, results: Path) -> Iterator[tuple[str, bytes]]:
    """Yield every file of the site by its path in the folder; raises InputError for a store that cannot be shown."""
    site = Site(store, results, read(store))
    for folder in STATIC:
        items = sorted(files("bench.reporting.page").joinpath(folder).iterdir(), key=lambda item: item.name)
        kept = (item for item in items if item.name.endswith((".js", ".css", ".txt")))
        yield from ((f"{folder}/{item.name}", item.read_bytes()) for item in kept)
    yield from board.data_files(site)
    for path, template, values in pages(site):
        yield path, rendered(template, site=site, **values).encode()


def pages(site: Site) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """The pages: path, template, and what it is about."""
    yield "index.md", "home", home_values(site)
    yield "leaderboard.md", "leaderboard", leaderboard_values(site)
    yield "methods.md", "methods", {"methods": list(map(described, registered()))}
    yield "systems.md", "systems", {}
    yield "scenarios.md", "scenarios", {"panels": site.panels}
    yield "figures.md", "figures", {"pictures": pictures(site.results / "figures")}
    yield "provenance.md", "provenance", provenance_values(site)
    for name, panels in site.systems.items():
        address = urlencode({"System": board.choices(panels[0])["System"]})
        yield f"systems/{site.system_slugs[name]}.md", "system", {"name": name, "panels": panels, "address": address}
    for label, slug in site.methods.items():
        yield f"methods/{slug}.md", "method", method_values(site, label)
    for panel in site.panels:
        yield f"scenarios/{panel.slug}.md", "scenario", scenario_values(site, panel)
    for one in site.advice:
        yield one.href, "situation", {"advice": one}


def home_values(site: Site) -> dict[str, Any]:
    """The first screen: all rankings, the first of which says most, and how much is behind them."""
    run = [result for panel in site.panels for result in panel.methods]
    return {
        "rankings": [*site.drawn, *site.advice, *elsewhere(site.results)],
        "first": next((one for one in site.advice if not one.hopeless), None),
        "counts": {"methods": len({result.method for result in run}), "fits": sum(result.n for result in run)},
    }


def leaderboard_values(site: Site) -> dict[str, Any]:
    """What the leaderboard shows at first: a scenario of the first situation."""
    panels = site.advice[0].panels if site.advice else site.panels
    return {"first": urlencode(board.first_choice(panels) if panels else {}), "hidden": ",".join(board.HIDDEN)}


def described(label: str) -> dict[str, Any]:
    """A method or variant: its card, what it serves, its settings, and what keeps it from running here."""
    plain, name = unmarked(label), method_name(label)
    sets = {} if name == plain else {key: text for key, text in read_yaml("method", plain).items() if key != "defaults"}
    found = {"label": label, "name": name, "card": card_of(label), "sets": sets, "serves": {}, "settings": {}}
    try:
        serves, settings = asdict(load_method(name).scope), {**default_settings(name), **sets}
    except InputError as error:
        return {**found, "missing": str(error)}
    return {**found, "serves": serves, "settings": settings, "missing": missing_package(name) or ""}


def method_values(site: Site, label: str) -> dict[str, Any]:
    """A method or variant: its card, its place in each ranking, and what was verified of it."""
    rankings = [*site.drawn, *site.advice]
    stored = [result for result in site.reading.stored if unmarked(result.label) == label]
    return {
        "method": described(label), "title": title(label), "address": urlencode({"Method": title(label)}),
        "places": [(one, row) for one in rankings for row in one.ranking if unmarked(row.label) == label],
        "verification": next((result.verification for result in stored if result.verification), ""),
        "computed": computed(stored),
    }  # fmt: skip


def scenario_values(site: Site, panel: ScenarioPanel) -> dict[str, Any]:
    """A scenario: what was told, and a line a method, the first tier first."""
    ranks = {row.label: row for row in site.alone[panel.slug].ranking}
    places = {label: place for place, label in enumerate(ranks)}
    order = sorted(panel.results, key=lambda result: (places.get(result.label, len(places)), result.label))
    facts = panel.facts
    coverages = {result.label: coverage(result, panel) for result in order}
    again = f"-m experiment={panel.experiments[0]}" if panel.experiments else f"reproduce cell={facts.identity[:8]}"
    return {
        "panel": panel, "facts": facts, "results": order, "ranks": ranks, "seconds": site.alone[panel.slug].seconds,
        "situations": [one for one in site.advice if panel in one.panels], "again": again,
        "address": urlencode(board.choices(panel)), "coverage": coverages, "computed": computed(order),
    }  # fmt: skip


def coverage(result: Result, panel: ScenarioPanel) -> float:
    """The share of the 95 % intervals, of all quantities that the data tell, that held the truth; NaN without any."""
    hits = [hit for metric in panel.ranked for hit in result.successful(f"{quantity(metric)}_coverage_95")]
    return float(np.mean(hits)) if hits else math.nan


def pictures(folder: Path) -> list[dict[str, Any]]:
    """The figures of a folder by name, each with its caption and its size in pixels."""
    from PIL import Image

    found = []
    for path in sorted(folder.glob("*.png")) if folder.is_dir() else []:
        with Image.open(path) as image:
            size = image.size
        words = [title(word) if card_of(word) else word for word in path.stem.split("_")]
        heading = " ".join(words).replace("snr", "SNR")
        heading = heading[:1].upper() + heading[1:]
        found.append({"name": path.stem, "heading": heading, "caption": caption_of(path), "size": size})
    return found


def provenance_values(site: Site) -> dict[str, Any]:
    """Where the cells come from, what is stale or missing, and what failed."""
    cells, shown = origin.cells_of(site.reading.stored), [result for panel in site.panels for result in panel.results]
    return {
        "cells": cells, "commits": origin.commits_here(cells), "hidden": site.reading.hidden,
        "stale": origin.counted(cells, "changed"), "experiments": origin.experiments(cells),
        "origins": {name: origin.counted(cells, name) for name in ("commit", "machine", "packages")},
        "failures": origin.not_ok(shown, unsupported=False),
        "unsupported": origin.not_ok(shown, unsupported=True),
    }  # fmt: skip
