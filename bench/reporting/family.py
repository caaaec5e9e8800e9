"""Families of variants of one method, sorted into sections by the setting that differs from a base.

A family consists of the variants of the experiment's method whose card has choices. The experiment's ``table`` gives
the ``bases`` (their settings that are not at the default), the ``factors`` (settings by heading), the ``references``,
and ``names`` of values that the card does not name. A variant belongs to the section of each factor and base from
which it differs in one setting. Variants that differ in several of the settings of ``product`` are combinations.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from bench.contract.method import Card
from bench.entrants.registry import default_settings
from bench.errors import InputError
from bench.reporting.frame import Frame, Result, group
from bench.reporting.labels import cards, title

Place = tuple[float, str]
"""Noise level (dB), and whether the initial state is known or unknown."""
PLACE: Place = (20.0, "known")
"""Scenario of the comparison of trainings."""
Settings = Mapping[str, Any]


def changed_settings(result: Result) -> dict[str, Any]:
    """Return the settings of a result that are not at their defaults; all, if its method is not installed."""
    try:
        usual = default_settings(result.method)
    except InputError:
        return dict(result.settings)
    return {name: value for name, value in result.settings.items() if name not in usual or usual[name] != value}


def has_choices(method: str) -> bool:
    """Return whether a method is a family."""
    card = cards().get(method)
    return card is not None and bool(card.choices)


def is_variant(result: Result) -> bool:
    """Return whether a result is a variant of a family, which only the table and the figure of the family show."""
    return has_choices(result.method) and result.label != result.method


@dataclass(frozen=True, eq=False)
class Variant:
    """A method with some settings, in all scenarios.

    Attributes:
        method: Name of the method.
        settings: Settings that are not at their defaults.
        title: Title in the section.
        cells: Results by scenario.
        base: Whether the other variants of the section are compared with this one.
    """

    method: str
    settings: Settings
    title: str
    cells: Mapping[Place, Result]
    base: bool = False

    def stored_cell(self, place: Place) -> Result | None:
        """Return the stored cell of a scenario, or None."""
        cell = self.cells.get(place)
        return cell if cell and cell.stored else None


@dataclass(frozen=True)
class Section:
    """Rows of a factor around a base, or rows outside of all factors (``base`` is empty or says why)."""

    heading: str
    base: str
    settings: Sequence[str]
    rows: Sequence[Variant]

    def common(self, place: Place) -> int:
        """Return the number of data sets that all stored rows have in common; these are the first of each."""
        return min((cell.n for row in self.rows if (cell := row.stored_cell(place))), default=0)


@dataclass(frozen=True)
class Names:
    """Titles of values of settings: from the card, else from the experiment, else setting and value."""

    card: Card
    more: Mapping[str, Any]
    usual: Settings

    def of(self, setting: str, value: Any) -> str:
        """Return the title of a value."""
        if choice := self.card.choices.get(setting, {}).get(str(value)):
            return choice.title
        stated = self.more.get(setting, {})
        if isinstance(stated, str):
            return stated.format(value)
        return str(stated.get(str(value), f"{setting.replace('_', ' ')} {value}"))

    def order(self, setting: str, value: Any) -> float:
        """Return the sort key of a value of a setting: the order of the card, numbers by size."""
        known = list(self.card.choices.get(setting, {}))
        if str(value) in known:
            return float(known.index(str(value)))
        return float(value) if isinstance(value, int | float) else math.inf

    def joined(self, settings: Settings) -> str:
        """Return the titles of several values; without any, those of the defaults of all choices."""
        named = settings or {setting: self.usual[setting] for setting in self.card.choices}
        return "; ".join(self.of(setting, value) for setting, value in named.items())


@dataclass(frozen=True)
class Family:
    """The variants of a method, in sections.

    Attributes:
        method: Name of the method.
        names: Titles of values of settings.
        places: Scenarios.
        bases: Settings of each base that are not at their defaults, by name.
        sections: Sections, in order.
        combinations: Variants that differ in several settings.
        variants: All variants, those of other methods included.
    """

    method: str
    names: Names
    places: Sequence[Place]
    bases: Mapping[str, Settings]
    sections: Sequence[Section]
    combinations: Section
    variants: Sequence[Variant]

    def section(self, setting: str, base: int) -> Section | None:
        """Return the section that varies a setting around the first or the second base, or None."""
        name = [*self.bases, "", ""][base]
        return next((s for s in self.sections if setting in s.settings and s.base == name), None)


def family_of(frame: Frame) -> Family:
    """Return the family of an experiment; raises InputError if none of its methods has choices."""
    method = next((result.method for result in frame if has_choices(result.method)), None)
    if method is None:
        raise InputError("table.form", "family", "an experiment with a method whose card has choices")
    table = frame.table
    names = Names(cards()[method], table.get("names", {}), default_settings(method))
    variants = list(_variants(frame, method, names))
    members = [variant for variant in variants if variant.method == method]
    stated, factors = table.get("bases", {"base": {}}), table.get("factors", {})
    bases = {name: {s: v for s, v in values.items() if names.usual.get(s) != v} for name, values in stated.items()}
    by_factor = [
        section
        for heading, settings in factors.items()
        for section in _sections(heading, settings, members, bases, method, names)
    ]
    placed = [*(row.settings for section in by_factor for row in section.rows), *bases.values()]
    rest = [variant for variant in members if variant.settings not in placed]
    product, references = list(table.get("product", [])), list(table.get("references", []))
    combined = [variant for variant in rest if set(variant.settings) <= set(product)]
    several = group([v for v in rest if v not in combined], lambda variant: _last_factor(variant, factors))
    sections = [
        Section("Reference rows", "", (), [v for name in references for v in variants if v.method == name]),
        *by_factor,
        *(Section(heading, "several settings at once", (), rows) for heading, rows in several.items()),
        Section("Other packages", "", (), [v for v in variants if v.method not in (method, *references)]),
    ]
    places = sorted(dict.fromkeys(map(place, frame)), key=lambda where: where[1])
    combinations = Section("Combinations", "", product, combined)
    return Family(method, names, places, bases, [s for s in sections if s.rows], combinations, variants)


def place(result: Result) -> Place:
    """Return the scenario of a result."""
    return result.snr_db, result.initial_state


def _variants(frame: Frame, method: str, names: Names) -> Iterator[Variant]:
    """Yield each method with its settings, and in each scenario the result with most replicates."""
    by_settings = group(frame, lambda result: (result.method, str(sorted(changed_settings(result).items()))))
    for (name, _), results in by_settings.items():
        settings, first = changed_settings(results[0]), results[0]
        if name == method:
            heading = names.joined(settings)
        elif first.label in cards():
            heading = first.title
        else:
            changes = (f"{setting.replace('_', ' ')} {value}" for setting, value in settings.items())
            heading = "; ".join([title(name), *changes])
        by_size = sorted(results[::-1], key=lambda result: result.n)
        yield Variant(name, settings, heading, {place(result): result for result in by_size})


def _sections(
    heading: str, settings: Sequence[str], variants: Sequence[Variant], bases: Mapping[str, Settings], method: str,
    names: Names,
) -> Iterator[Section]:  # fmt: skip
    """Yield a section for each base that has variants which differ in one of the settings, sorted by its value."""
    for base, usual in bases.items():
        neighbours = []
        for variant in variants:
            if len(changed := different(variant.settings, usual)) == 1 and changed <= set(settings):
                setting = changed.pop()
                value = variant.settings.get(setting, names.usual.get(setting))
                order = (settings.index(setting), names.order(setting, value))
                neighbours.append((order, replace(variant, title=names.of(setting, value))))
        if neighbours:
            title_of_base = names.joined({name: usual.get(name, names.usual.get(name)) for name in settings})
            cells = next((variant.cells for variant in variants if variant.settings == usual), {})
            rows = [row for _, row in sorted(neighbours, key=lambda pair: pair[0])]
            yield Section(heading, base, settings, [Variant(method, usual, title_of_base, cells, base=True), *rows])


def _last_factor(variant: Variant, factors: Mapping[str, Iterable[str]]) -> str:
    """Return the heading of the last factor with a setting that a variant changes."""
    headings = [heading for heading, settings in factors.items() if set(settings) & set(variant.settings)]
    return headings[-1] if headings else "Other settings"


def different(settings: Settings, others: Settings) -> set[str]:
    """Return the names of the settings in which two variants differ, given those not at their defaults."""
    missing = math.nan
    return {name for name in {*settings, *others} if settings.get(name, missing) != others.get(name, missing)}
