"""Pages of the results in Markdown with their data, from which mkdocs builds a site that opens from a folder.

The pages depend on stored cells, their arrays, and a folder of results (tables, figures) alone, so the same store gives
the same pages. Each page is a template with its values. ``python -m bench report`` builds a site of these pages;
``docs/hooks.py`` adds them to the documentation.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import numpy as np
from markupsafe import Markup

from bench.config.files import read_yaml
from bench.contract.method import Scope
from bench.entrants.registry import default_settings, load_method, missing_package, registered
from bench.errors import InputError
from bench.reporting.frame import Result, computed, group, quantity
from bench.reporting.labels import card_of, in_order, title
from bench.reporting.page import board, origin
from bench.reporting.page.home import method_name
from bench.reporting.page.markdown import escaped, link, rendered
from bench.reporting.page.reading import ScenarioPanel, StoreReading, read
from bench.reporting.page.situations import Advice, advice, advise
from bench.reporting.page.tracks import track_rankings
from bench.reporting.page.words import slugs
from bench.reporting.pictures.png import caption_of
from bench.reporting.tables.leaderboard import parts
from bench.store.store import Store
from bench.store.stored_cell import unmarked
from bench.store.table_versions import read_versions, tables_without_versions

NAV = {
    "Home": "index.md", "Which method?": "which_method.md", "Can I trust this?": "trust.md",
    "Leaderboard": "leaderboard.md", "Methods": "methods.md", "Systems": "systems.md", "Scenarios": "scenarios.md",
    "Figures": "figures.md",
}  # fmt: skip
"""Navigation of the site of a store."""
MOST_NAMED = 4
"""Largest number of methods of a tier that are listed by name."""
STATIC = ("static", "static/tables", "static/vega")
SUPPORTED: Mapping[str, Callable[[Scope], bool]] = {
    "Known force": lambda scope: scope.forced,
    "Several masses": lambda scope: scope.max_dof != 1,
    "Nonlinear": lambda scope: scope.nonlinear,
    "Velocity, acceleration": lambda scope: len(scope.measures) > 1,
    "Several sensors": lambda scope: scope.several_channels,
    "Several records": lambda scope: scope.several_records,
    "Sensor offset": lambda scope: scope.offsets,
    "Without prior": lambda scope: scope.free_without_prior,
}
"""Columns of the table of supported data, and whether a method's scope contains such data."""


@dataclass(frozen=True, eq=False)
class Site:
    """Data of all pages; ``results`` is the folder of tables and figures. Links begin at the root of the site."""

    store: Store
    results: Path
    reading: StoreReading

    @property
    def panels(self) -> tuple[ScenarioPanel, ...]:
        return self.reading.panels

    @cached_property
    def methods(self) -> Mapping[str, str]:
        """Addresses of all stored methods, variants and reference rows, and of all registered methods."""
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
        """Rankings of the situations."""
        return advise(self.panels)

    @cached_property
    def drawn(self) -> list[Advice]:
        """Rankings of the open split, below and beyond Nyquist."""
        split = {f"One mass, random tests, {part}": its for part, its in parts(self.reading.drawn).items() if its}
        return [advice(title, "results/leaderboard.md", results) for title, results in split.items()]

    @cached_property
    def rankings(self) -> list[Advice]:
        """All rankings: situations, open split, measured and online track."""
        return [*self.advice, *self.drawn, *track_rankings(self.results)]

    @cached_property
    def alone(self) -> Mapping[str, Advice]:
        """Ranking of each scenario, by its address."""
        return {p.slug: advice(p.title, f"scenarios/{p.slug}.md", p.results, [p]) for p in self.panels}

    def method(self, label: str) -> Markup:
        """Return the title of a method, as a link to its page; a submitted method links to the page of its method."""
        slug = self.methods.get(unmarked(label))
        return link(f"/methods/{slug}.md", title(label)) if slug else escaped(title(label))

    def tier(self, advice: Advice) -> Markup:
        """List the methods of a first tier, or the first of them with the number of the others."""
        labels = [row.label for row in advice.first_tier]
        named = Markup(", ").join(map(self.method, labels[:MOST_NAMED]))
        return named + (f" or {len(labels) - MOST_NAMED} more" if len(labels) > MOST_NAMED else "")

    def system(self, name: str) -> Markup:
        """Return a link to the page of a system."""
        return link(f"/systems/{self.system_slugs[name]}.md", name)

    def page(self, advice: Advice) -> Markup:
        """Return the title of a ranking, as a link if its page exists."""
        exists = not advice.href.startswith("results/") or (self.results / Path(advice.href).name).is_file()
        return link(f"/{advice.href}", advice.title) if exists else escaped(advice.title)


def site_files(store: Store, results: Path) -> Iterator[tuple[str, bytes]]:
    """Yield all files of the site with their paths; raises InputError for a store that cannot be shown."""
    site = Site(store, results, read(store))
    for folder in STATIC:
        items = sorted(files("bench.reporting.page").joinpath(folder).iterdir(), key=lambda item: item.name)
        kept = (item for item in items if item.name.endswith((".js", ".css", ".txt")))
        yield from ((f"{folder}/{item.name}", item.read_bytes()) for item in kept)
    yield from board.data_files(site)
    for path, template, values in pages(site):
        yield path, rendered(template, site=site, **values).encode()


def pages(site: Site) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Yield the pages: path, template, and values."""
    yield "index.md", "home", home_values(site)
    yield "which_method.md", "which_method", which_method_values(site)
    yield "trust.md", "trust", trust_values(site)
    yield "leaderboard.md", "leaderboard", leaderboard_values(site)
    yield "methods.md", "methods", {"methods": list(map(described, registered()))}
    yield "systems.md", "systems", {}
    yield "scenarios.md", "scenarios", {"panels": site.panels}
    yield "figures.md", "figures", {"pictures": pictures(site.results / "figures")}
    for name, panels in site.systems.items():
        address = urlencode({"System": board.choices(panels[0])["System"]})
        yield f"systems/{site.system_slugs[name]}.md", "system", {"name": name, "panels": panels, "address": address}
    for label, slug in site.methods.items():
        yield f"methods/{slug}.md", "method", method_values(site, label)
    for panel in site.panels:
        yield f"scenarios/{panel.slug}.md", "scenario", scenario_values(site, panel)
    for ranked in site.advice:
        yield ranked.href, "situation", {"advice": ranked}


def home_values(site: Site) -> dict[str, Any]:
    """Return the values of the home page: the first ranking with a recommendation, and counts."""
    run = [result for panel in site.panels for result in panel.methods]
    return {
        "first": next((advice for advice in site.advice if not advice.hopeless), None),
        "counts": {"methods": len({result.method for result in run}), "fits": sum(result.n for result in run)},
    }


def which_method_values(site: Site) -> dict[str, Any]:
    """Return the values of "Which method?": all rankings, conclusions from them, and supported data by method."""
    places = Counter(row.label for advice in _usable(site) for row in advice.first_tier)
    scopes = []
    for label in in_order(registered()):
        with suppress(InputError):  # a method that cannot be loaded has no scope
            scope = load_method(label).scope
            scopes.append((label, [supports(scope) for supports in SUPPORTED.values()], places[label]))
    return {
        "rankings": site.rankings, "sentences": conclusions(site), "columns": list(SUPPORTED), "scopes": scopes,
    }  # fmt: skip


def _usable(site: Site) -> list[Advice]:
    """Return the rankings of simulated situations with a recommendation."""
    return [advice for advice in site.advice if not advice.hopeless]


def conclusions(site: Site) -> list[Markup]:
    """Say which methods are in the first tier most often, which of these are fastest, and where none is recommended."""
    usable = _usable(site)
    if not usable:
        return []
    tiers = [{row.label for row in advice.first_tier} for advice in usable]
    counts = Counter(label for tier in tiers for label in tier)
    most = [label for label in in_order(counts) if counts[label] == max(counts.values())]
    names = Markup(", ").join(map(site.method, most))
    each = " each" if len(most) > 1 else ""
    sentences = [f"{names}: in the first tier of {counts[most[0]]} of {len(usable)} situations{each}."]
    fastest = Counter(advice.fastest.label for advice in usable)
    label, times = max(fastest.items(), key=lambda item: (item[1], item[0]))
    sentences.append(f"{site.method(label)}: the fastest of the first tier in {times} of {len(usable)} situations.")
    if hopeless := [site.page(advice) for advice in site.advice if advice.hopeless]:
        sentences.append(f"No method is reliable in: {Markup('; ').join(hopeless)}. Extend the model first.")
    return list(map(Markup, sentences))


def leaderboard_values(site: Site) -> dict[str, Any]:
    """Return the first view of the leaderboard: a scenario of the first situation."""
    panels = site.advice[0].panels if site.advice else site.panels
    return {"first": urlencode(board.first_choice(panels) if panels else {}), "hidden": ",".join(board.HIDDEN)}


def described(label: str) -> dict[str, Any]:
    """Return the card, scope and settings of a method or variant, and the package that it lacks, if any."""
    plain, name = unmarked(label), method_name(label)
    sets = {} if name == plain else {key: text for key, text in read_yaml("method", plain).items() if key != "defaults"}
    values = {"label": label, "name": name, "card": card_of(label), "sets": sets, "scope": {}, "settings": {}}
    try:
        scope, settings = asdict(load_method(name).scope), {**default_settings(name), **sets}
    except InputError as error:
        return {**values, "missing": str(error)}
    return {**values, "scope": scope, "settings": settings, "missing": missing_package(name) or ""}


def method_values(site: Site, label: str) -> dict[str, Any]:
    """Return the values of a method's page: card, place in each ranking, and verification."""
    rankings = [*site.drawn, *site.advice]
    stored = [result for result in site.reading.stored if unmarked(result.label) == label]
    return {
        "method": described(label), "title": title(label), "address": urlencode({"Method": title(label)}),
        "places": [(ranked, row) for ranked in rankings for row in ranked.ranking if unmarked(row.label) == label],
        "verification": next((result.verification for result in stored if result.verification), ""),
        "computed": computed(stored),
    }  # fmt: skip


def scenario_values(site: Site, panel: ScenarioPanel) -> dict[str, Any]:
    """Return the values of a scenario's page: its facts, and its methods, the first tier first."""
    ranks = {row.label: row for row in site.alone[panel.slug].ranking}
    places = {label: place for place, label in enumerate(ranks)}
    order = sorted(panel.results, key=lambda result: (places.get(result.label, len(places)), result.label))
    facts = panel.facts
    coverages = {result.label: coverage(result, panel) for result in order}
    command = f"-m experiment={panel.experiments[0]}" if panel.experiments else f"reproduce cell={facts.identity[:8]}"
    return {
        "panel": panel, "facts": facts, "results": order, "ranks": ranks, "seconds": site.alone[panel.slug].seconds,
        "situations": [advice for advice in site.advice if panel in advice.panels], "command": command,
        "address": urlencode(board.choices(panel)), "coverage": coverages, "computed": computed(order),
    }  # fmt: skip


def coverage(result: Result, panel: ScenarioPanel) -> float:
    """Return the coverage of the 95 % intervals of all identifiable quantities; NaN without any."""
    hits = [hit for metric in panel.ranked for hit in result.successful(f"{quantity(metric)}_coverage_95")]
    return float(np.mean(hits)) if hits else math.nan


def pictures(folder: Path) -> list[dict[str, Any]]:
    """Return the figures of a folder with their captions and sizes in pixels."""
    from PIL import Image

    figures = []
    for path in sorted(folder.glob("*.png")) if folder.is_dir() else []:
        with Image.open(path) as image:
            size = image.size
        words = [title(word) if card_of(word) else word for word in path.stem.split("_")]
        heading = " ".join(words).replace("snr", "SNR")
        heading = heading[:1].upper() + heading[1:]
        figures.append({"name": path.stem, "heading": heading, "caption": caption_of(path), "size": size})
    return figures


def trust_values(site: Site) -> dict[str, Any]:
    """Return the values of "Can I trust this?": commits, what is stale or missing, and failed fits."""
    cells, shown = origin.cells_of(site.reading.stored), [result for panel in site.panels for result in panel.results]
    versions = read_versions(site.results)
    return {
        "cells": cells, "hidden": site.reading.hidden, "experiments": origin.experiments(cells),
        "commits": origin.commits_here(cells), "failures": origin.failed_fits(shown),
        "versions": versions, "unstated": tables_without_versions(site.results, versions),
        "groups": {
            "Reasons for stale cells": origin.counted(cells, "changed"), "Commits": origin.counted(cells, "commit"),
        },
    }  # fmt: skip
