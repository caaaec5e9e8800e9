"""The results as pages in Markdown with their data, from which mkdocs makes a site that opens from a folder.

From stored cells, their arrays and a folder of results (tables, figures) alone; nothing is computed anew but ranks. The
same store gives the same pages. ``python -m bench report`` makes a site of them alone, ``docs/hooks.py`` adds them to
the documentation.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

from markupsafe import Markup

from bench.reporting.frame import Result, group
from bench.reporting.labels import in_order, title
from bench.reporting.page import board, cards, describe, home, origin, told
from bench.reporting.page.addresses import scenario_slugs, slugs
from bench.reporting.page.markdown import code, escaped, link, rendered, table
from bench.reporting.page.pictures import PagePicture, pictures
from bench.reporting.page.reading import ScenarioPanel, StoreReading, decibels, read
from bench.reporting.page.situations import Advice, advice, advise
from bench.reporting.page.sketch import sketch
from bench.reporting.page.untold import untold
from bench.reporting.page.words import heading, number, percent, quantity, seconds, unbroken
from bench.reporting.ranking import Ranked, median_time
from bench.reporting.tables.leaderboard import parts
from bench.reporting.tables.render import Columns
from bench.store.store import Store

NAV = {
    "Which method?": "index.md", "Leaderboard": "leaderboard.md", "Methods": "methods.md", "Systems": "systems.md",
    "Scenarios": "scenarios.md", "Figures": "figures.md", "Can I trust these numbers?": "provenance.md",
}  # fmt: skip
"""The pages that a site of a store's results names in its head."""
LEADERBOARD = "results/leaderboard.md"
Placed = tuple[Advice, Ranked]
"""A ranking, and a method's place in it."""


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
    def first_tiers(self) -> board.FirstTiers:
        return board.first_tiers(self.panels)

    @cached_property
    def cards(self) -> list[cards.Description]:
        return cards.cards()

    @cached_property
    def metrics(self) -> list[str]:
        """The quantities of all scenarios, displacement last."""
        names = dict.fromkeys(metric for panel in self.panels for metric in panel.metrics)
        return [*(name for name in names if name != "rmse"), *(["rmse"] if "rmse" in names else [])]

    @cached_property
    def advice(self) -> list[Advice]:
        return advise(self.panels)

    @cached_property
    def drawn(self) -> list[Advice]:
        """The rankings of the open split, below and beyond Nyquist."""
        split = parts(self.reading.drawn).items()
        return [advice(f"One mass, drawn tests, {part}", LEADERBOARD, its) for part, its in split if its]

    @cached_property
    def pictures(self) -> list[PagePicture]:
        return pictures(self.results / "figures")

    def method(self, root: str, label: str, name: str = "") -> Markup:
        """The name of a method, a link where it has a page."""
        name = name or title(label)
        return link(f"{root}methods/{self.methods[label]}.md", name) if label in self.methods else escaped(name)

    def scenario(self, root: str, place: int) -> Markup:
        return link(f"{root}scenarios/{self.scenarios[place]}.md", self.words[place])

    def system(self, root: str, name: str, words: object = None) -> Markup:
        return link(f"{root}systems/{self.system_slugs[name]}.md", words or name)

    def situation(self, root: str, one: Advice | home.HomeRow) -> Markup:
        """The words of a ranking, a link where its page is there."""
        there = one.href.startswith("situations") or (self.results / Path(one.href).name).is_file()
        return link(f"{root}{one.href}", one.words) if there else escaped(one.words)


def site_files(store: Store, results: Path) -> Iterator[tuple[str, bytes]]:
    """Yield every file of the site by its path in the folder; raises InputError for a store that cannot be shown."""
    site = Site(store, results, read(store))
    folder = files("bench.reporting.page")
    for name in ("static", "static/tables", "static/vega"):
        items = sorted(folder.joinpath(name).iterdir(), key=lambda one: one.name)
        yield from (
            (f"{name}/{item.name}", item.read_bytes()) for item in items if item.name.endswith((".js", ".css", ".txt"))
        )
    yield from board.data_files(site)
    for path, text in _pages(site):
        yield path, text.encode()


def first_choice(site: Site) -> dict[str, str]:
    """What the leaderboard shows at first: a scenario of the first screen's first situation, at a middle noise."""
    own = list(site.advice[0].panels) if site.advice else list(site.panels[:1])
    level = told.usual(own)
    panel = next(p for p in own if p.facts.snr_db == level)
    return {**board.choices(panel), **({"Error of": heading(panel.ranked[0])} if panel.ranked else {})}


def _pages(site: Site) -> Iterator[tuple[str, str]]:
    """The pages by path."""
    yield "index.md", home_page(site)
    yield "leaderboard.md", rendered("leaderboard", first=urlencode(first_choice(site)), hidden=",".join(board.HIDDEN))
    yield "methods.md", rendered("methods", table=table(site.cards, methods_columns(site)))
    yield "systems.md", rendered("systems", table=table(site.systems, systems_columns(site)))
    yield "scenarios.md", rendered("scenarios", table=scenario_table(site, "", range(len(site.panels))))
    yield "figures.md", rendered("figures", pictures=site.pictures)
    yield "provenance.md", rendered("provenance", **provenance_values(site))
    for name in site.systems:
        yield f"systems/{site.system_slugs[name]}.md", system_page(site, name)
    for label in site.labels:
        yield f"methods/{site.methods[label]}.md", method_page(site, label)
    for place, slug in enumerate(site.scenarios):
        yield f"scenarios/{slug}.md", scenario_page(site, place)
    for one in site.advice:
        yield one.href, situation_page(site, one)


def home_page(site: Site) -> str:
    """The first screen."""
    first = site.advice[0] if site.advice else None
    panels = first.panels if first else site.panels
    best = home.advice_row(first) if first and not first.hopeless else None
    rows = home.rows([*site.drawn, *site.advice], site.results)
    methods = {result.method for panel in site.panels for result in panel.methods}
    fits = sum(result.n for panel in site.panels for result in panel.methods)
    return rendered(
        "home", table=table(rows, home_columns(site)), first=first, best=best, noise=told.noise(panels),
        tier=named_methods(site, best) if best else "",
        fastest=site.method("", first.fastest.label) if first and best else "",
        limit=home.one_in(home.at_most(first.fastest)) if first and best else "", untold=untold(panels[0]),
        unbroken=unbroken, ranked=list(map(quantity, told.ranked(panels[0]))), basis=home.basis_of(panels),
        counts=(len(methods), len(site.systems), fits),
    )  # fmt: skip


def named_methods(site: Site, row: home.HomeRow) -> Markup:
    """The methods of a first tier, and how many more there are."""
    named = Markup(", ").join(site.method("", label, name) for name, label in row.methods)
    return Markup("{} or {} more").format(named, row.more) if row.more else named


def home_columns(site: Site) -> Columns[home.HomeRow]:
    """What the first screen's table says of a situation."""
    return {
        "Situation": lambda row: site.situation("", row) + small("; ".join(filter(None, (row.basis, row.tells)))),
        "Methods": lambda row: named_methods(site, row) + small(row.fastest and f"fastest: {row.fastest}"),
        "Error over the bound": lambda row: escaped(row.error) + small(row.accuracy),
        "Lost fits": lambda row: unbroken(row.risk),
        "Time per fit": lambda row: row.time,
        "Needs": lambda row: row.needs,
    }


def small(text: str) -> Markup:
    """What stands below a cell's text, in small letters."""
    shown = text if isinstance(text, Markup) else escaped(unbroken(text))
    return Markup(f" <small>{shown}</small>") if text else Markup("")


def methods_columns(site: Site) -> Columns[cards.Description]:
    """What the table of methods says of each."""
    return {
        "Method": lambda one: site.method("", one.name, one.title) + " " + code(one.name),
        "What it does": lambda one: one.card.summary if one.card else one.broken,
        "Variants": lambda one: Markup("; ").join(site.method("", name, words) for name, words, _ in one.variants),
    }


def systems_columns(site: Site) -> Columns[str]:
    """What the table of systems says of each."""

    def facts(name: str) -> Result:
        return site.panels[site.systems[name][0]].facts

    return {
        "System": lambda name: site.system("", name, describe.system_words(facts(name))) + " " + code(name),
        "Sketch": lambda name: Markup(sketch(facts(name))),
        "Parameters": lambda name: describe.values(facts(name)) if len(facts(name).parameters) <= describe.FEW else "",
        "Scenarios": lambda name: str(len(site.systems[name])),
    }


def scenario_table(site: Site, root: str, places: Iterable[int]) -> Markup:
    """Scenarios, a row each."""
    columns: Columns[int] = {
        "Scenario": lambda i: site.scenario(root, i),
        "System": lambda i: site.system(root, site.panels[i].facts.system),
        "SNR (dB)": lambda i: decibels(site.panels[i].facts.snr_db),
        "Initial state": lambda i: site.panels[i].facts.initial_state,
        "Data": lambda i: site.panels[i].kind,
        "Methods": lambda i: str(len(site.panels[i].methods)),
        "Data sets": lambda i: str(max((cell.n for cell in site.panels[i].methods), default=0)),
        "Table": lambda i: ", ".join(one.said for one in site.panels[i].experiments) or "–",
    }
    return table(places, columns)


def system_page(site: Site, name: str) -> str:
    """A system: what it is, its parameters, its scenarios, and the prior's share in what is told."""
    own = site.systems[name]
    facts = site.panels[own[0]].facts
    shares: dict[str, str] = {}
    for i in own:
        for parameter, part in site.panels[i].prior_share.items():
            shares.setdefault(quantity(f"{parameter}_error_pct"), percent(part))
    about = (type(facts.known_model).__doc__ or "").strip().split("\n")[0] if facts.known_model else ""
    return rendered(
        "system", name=name, words=describe.system_words(facts), sketch=Markup(sketch(facts)),
        about=about.replace("``", ""), values=describe.values(facts), shares=shares,
        address=urlencode({"System": board.choices(site.panels[own[0]])["System"]}),
        table=scenario_table(site, "../", own),
    )  # fmt: skip


def ranked_columns(first: Columns[Placed]) -> Columns[Placed]:
    """What is said of a method in a ranking, behind the columns that name it."""
    return {
        **first,
        "Error over the bound": lambda line: f"{line[1].typical:.2f} ({line[1].low:.2f} to {line[1].high:.2f})",
        "Lost fits": lambda line: home.lost_text(line[1]),
        "Time per fit": lambda line: seconds(line[0].seconds[line[1].label]),
    }


def method_page(site: Site, label: str) -> str:
    """A method or variant: its card, and what it did in each situation and scenario."""
    found = {i: cell for i, panel in enumerate(site.panels) for cell in panel.results if cell.label == label}
    name = next((cell.method for cell in found.values()), label)
    card = next((card for card in site.cards if card.name == name), None)
    situations: Columns[Placed] = {
        "Situation": lambda line: site.situation("../", line[0]),
        "Standing": lambda line: home.standing_text(line[1]),
    }
    submitted = [cell for cell in (*site.reading.results, *site.reading.drawn) if cell.verification]
    scenarios: Columns[int] = {
        "Scenario": lambda i: site.scenario("../", i),
        "Error over the bound": lambda i: number(pooled(found[i], site.panels[i])),
        "Fits ok": lambda i: f"{found[i].n_ok}/{found[i].n}",
    }
    return rendered(
        "method", site=site, label=label, title=title(label), description=card, card=card.card if card else None,
        situations=table(standings(site, label), ranked_columns(situations)),
        verification=next((cell.verification for cell in submitted if cell.label == label), ""),
        scenarios=table(found, scenarios),
    )  # fmt: skip


def pooled(cell: Result, panel: ScenarioPanel) -> float:
    """A cell in a number: the median over the quantities that the data tell of the error over the bound."""
    return board.middle([cell.excess(metric) for metric in panel.ranked if metric in cell.summary])


def standings(site: Site, label: str) -> list[Placed]:
    """Where a method stands in each ranking that it is in."""
    return [(one, row) for one in (*site.drawn, *site.advice) for row in one.ranking if row.label == label]


def scenario_page(site: Site, place: int) -> str:
    """A scenario: what was told, and a line a method."""
    panel = site.panels[place]
    order = sorted(panel.results, key=lambda cell: (cell.is_reference, _last(pooled(cell, panel)), cell.label))
    columns: Columns[Result] = {
        "Method": lambda cell: site.method("../", cell.label, cell.title),
        "Error over the bound": lambda cell: number(pooled(cell, panel)),
        "First tier in": lambda cell: standing(site, place, cell),
        "Displacement’s median error (m)": lambda cell: number(cell.statistic("rmse", "median")),
        "Fits ok": lambda cell: f"{cell.n_ok}/{cell.n}",
        "Time per fit": lambda cell: seconds(median_time([cell])),
    }
    return rendered(
        "scenario", site=site, panel=panel, slug=site.scenarios[place], words=site.words[place],
        told=describe.told(panel), again=describe.again(panel), sketch=Markup(sketch(panel.facts)),
        untold=untold(panel), address=urlencode(board.choices(panel)), table=table(order, columns),
        situations=[site.situation("../", one) for one in site.advice if panel in one.panels],
    )  # fmt: skip


def _last(value: float) -> float:
    return math.inf if math.isnan(value) else value


def standing(site: Site, place: int, cell: Result) -> str:
    """In how many of the quantities that the data tell a method is in the first tier."""
    panel = site.panels[place]
    if cell.is_reference:
        return "reference"
    named = [
        board.standing_of(cell, site.first_tiers.get((place, metric)))
        for metric in panel.ranked
        if metric in cell.summary
    ]
    if not named or named[0] in ("unsupported", "failed"):
        return named[0] if named else "–"
    return f"{named.count('first tier')} of {len(named)}"


def situation_page(site: Site, one: Advice) -> str:
    """A situation: the tiers of its methods, and the scenarios behind it."""
    columns = ranked_columns({"Method": lambda line: site.method("../", line[1].label)})
    columns = {**columns, "Needs": lambda line: home.needs(home.method_of(*line))}
    beside: Columns[Placed] = {
        "Serves": lambda line: f"{line[1].served} of {line[1].scenarios}",
        "First tier there": lambda line: f"{line[1].first_tier:.2f}",
    }
    tiers = group(((one, row) for row in one.ranking), lambda line: line[1].tier)
    places = [i for i, panel in enumerate(site.panels) if panel in one.panels]
    return rendered(
        "situation", advice=one, places=places, scenarios=scenario_table(site, "../", places),
        tables={
            f"Tier {tier}" if tier else "Beside the tiers": table(lines, columns if tier else {**columns, **beside})
            for tier, lines in tiers.items()
        },
    )  # fmt: skip


def provenance_values(site: Site) -> dict[str, Any]:
    """Where the cells come from, and what failed."""
    results = site.reading.results

    def lines(headers: Sequence[str], rows: Sequence[Sequence[Any]]) -> Markup:
        return table(rows, {name: lambda row, i=i: str(row[i]) for i, name in enumerate(headers)})  # type: ignore[misc]

    return {
        "origin": origin.origin([*results, *site.reading.drawn]), "hidden": site.reading.hidden,
        "failures": lines(("Fits", "Method", "Status", "Scenario", "Message"), origin.failures(results)),
        "unsupported": lines(("Fits", "Method", "Reason"), origin.unsupported(results)),
    }  # fmt: skip
