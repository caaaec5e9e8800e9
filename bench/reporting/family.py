"""A family: the variants of one method, each one thing apart from a base, in sections.

The family is the method of an experiment whose card has choices. The experiment's ``table`` names the ``bases`` (what
each has not at its default), the ``factors`` (settings by heading), the ``references``, and the ``names`` of values
that have none on the card. A variant stands in the section of the factor and base that it is one setting apart from;
it may stand in several. What differs in several of the settings that ``product`` names is one of their combinations.
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
"""Noise level (dB) and reading of the initial state."""
PLACE: Place = (20.0, "known")
"""The scenario in which trainings are compared."""
Settings = Mapping[str, Any]


def changed_settings(result: Result) -> dict[str, Any]:
    """The settings of a result that are not at their defaults; all of them where its method is not installed here."""
    try:
        usual = default_settings(result.method)
    except InputError:
        return dict(result.settings)
    return {name: value for name, value in result.settings.items() if name not in usual or usual[name] != value}


def has_choices(method: str) -> bool:
    """Whether a method is a family."""
    card = cards().get(method)
    return card is not None and bool(card.choices)


def any_stored(frame: Frame) -> bool:
    """Whether any cell of a family is stored."""
    return any(result.stored and has_choices(result.method) for result in frame)


def is_variant(result: Result) -> bool:
    """Whether a result is a variant of a family, which stands in the family's table and picture alone."""
    return has_choices(result.method) and result.label != result.method


@dataclass(frozen=True, eq=False)
class Variant:
    """A method with ``settings`` (those not at their defaults) in all scenarios, as a section calls it.

    ``base``: what the others of the section are compared with.
    """

    method: str
    settings: Settings
    title: str
    cells: Mapping[Place, Result]
    base: bool = False

    def at(self, place: Place) -> Result | None:
        """The cell of a scenario where it is stored."""
        cell = self.cells.get(place)
        return cell if cell and cell.stored else None


@dataclass(frozen=True)
class Section:
    """Rows that belong together: those of a factor around a base, or those of neither."""

    heading: str
    base: str
    settings: Sequence[str]
    rows: Sequence[Variant]

    def common(self, place: Place) -> int:
        """How many data sets all rows have that are computed there: the first of the same."""
        return min((cell.n for row in self.rows if (cell := row.at(place))), default=0)


@dataclass(frozen=True)
class Names:
    """What values of settings are called: on the card, else in the experiment, else by setting and value."""

    card: Card
    more: Mapping[str, Any]
    usual: Settings

    def of(self, setting: str, value: Any) -> str:
        """The name of a value."""
        if choice := self.card.choices.get(setting, {}).get(str(value)):
            return choice.title
        stated = self.more.get(setting, {})
        if isinstance(stated, str):
            return stated.format(value)
        return str(stated.get(str(value), f"{setting.replace('_', ' ')} {value}"))

    def order(self, setting: str, value: Any) -> float:
        """The place of a value among those of its setting: as the card has them, numbers by size."""
        known = list(self.card.choices.get(setting, {}))
        if str(value) in known:
            return float(known.index(str(value)))
        return float(value) if isinstance(value, int | float) else math.inf

    def joined(self, settings: Settings) -> str:
        """The names of several values; of all choices at their defaults where there are none."""
        named = settings or {setting: self.usual[setting] for setting in self.card.choices}
        return "; ".join(self.of(setting, value) for setting, value in named.items())


@dataclass(frozen=True)
class Family:
    """``sections`` in order; ``bases`` by name, what each has not at its default; ``combinations`` of settings."""

    method: str
    names: Names
    places: Sequence[Place]
    bases: Mapping[str, Settings]
    sections: Sequence[Section]
    combinations: Section
    variants: Sequence[Variant]

    def section(self, setting: str, base: int) -> Section | None:
        """The section that varies a setting around the first or the second base."""
        name = [*self.bases, "", ""][base]
        return next((s for s in self.sections if setting in s.settings and s.base == name), None)


def family_of(frame: Frame) -> Family:
    """The family of an experiment; raises InputError where none of its methods has choices."""
    method = next((result.method for result in frame if has_choices(result.method)), None)
    if method is None:
        raise InputError("table.form", "family", "an experiment with a method whose card has choices")
    table = frame.table
    names = Names(cards()[method], table.get("names", {}), default_settings(method))
    variants = list(_variants(frame, method, names))
    ours = [variant for variant in variants if variant.method == method]
    stated, factors = table.get("bases", {"base": {}}), table.get("factors", {})
    bases = {name: {s: v for s, v in values.items() if names.usual.get(s) != v} for name, values in stated.items()}
    near = [s for heading, own in factors.items() for s in _sections(heading, own, ours, bases, method, names)]
    placed = [*(row.settings for section in near for row in section.rows), *bases.values()]
    left = [variant for variant in ours if variant.settings not in placed]
    product, references = list(table.get("product", [])), list(table.get("references", []))
    combined = [variant for variant in left if set(variant.settings) <= set(product)]
    several = group([v for v in left if v not in combined], lambda variant: _last_factor(variant, factors))
    sections = [
        Section("Reference rows", "", (), [v for name in references for v in variants if v.method == name]),
        *near,
        *(Section(heading, "several settings at once", (), rows) for heading, rows in several.items()),
        Section("Other packages", "", (), [v for v in variants if v.method not in (method, *references)]),
    ]
    places = sorted(dict.fromkeys(map(place, frame)), key=lambda where: where[1])
    combinations = Section("Combinations", "", product, combined)
    return Family(method, names, places, bases, [s for s in sections if s.rows], combinations, variants)


def place(result: Result) -> Place:
    """Where a result stands."""
    return result.snr_db, result.initial_state


def _variants(frame: Frame, method: str, names: Names) -> Iterator[Variant]:
    """Every method with its settings, its cells by scenario: those of most replicates."""
    alike = group(frame, lambda result: (result.method, str(sorted(changed_settings(result).items()))))
    for (name, _), results in alike.items():
        settings, first = changed_settings(results[0]), results[0]
        if name == method:
            called = names.joined(settings)
        elif first.label in cards():
            called = first.title
        else:
            changes = (f"{setting.replace('_', ' ')} {value}" for setting, value in settings.items())
            called = "; ".join([title(name), *changes])
        yield Variant(name, settings, called, {place(r): r for r in sorted(results[::-1], key=lambda own: own.n)})


def _sections(
    heading: str, settings: Sequence[str], variants: Sequence[Variant], bases: Mapping[str, Settings], method: str,
    names: Names,
) -> Iterator[Section]:  # fmt: skip
    """A section for each base that has more than its base: what differs in one of the settings, by their values."""
    for base, usual in bases.items():
        near = []
        for variant in variants:
            if len(different := apart(variant.settings, usual)) == 1 and different <= set(settings):
                setting = different.pop()
                value = variant.settings.get(setting, names.usual.get(setting))
                order = (settings.index(setting), names.order(setting, value))
                near.append((order, replace(variant, title=names.of(setting, value))))
        if near:
            called = names.joined({setting: usual.get(setting, names.usual.get(setting)) for setting in settings})
            cells = next((variant.cells for variant in variants if variant.settings == usual), {})
            rows = [row for _, row in sorted(near, key=lambda pair: pair[0])]
            yield Section(heading, base, settings, [Variant(method, usual, called, cells, base=True), *rows])


def _last_factor(variant: Variant, factors: Mapping[str, Iterable[str]]) -> str:
    """The heading of the last factor of which a variant has something changed."""
    headings = [heading for heading, settings in factors.items() if set(settings) & set(variant.settings)]
    return headings[-1] if headings else "Other settings"


def apart(settings: Settings, others: Settings) -> set[str]:
    """The settings in which two variants differ, each given by what it has not at its default."""
    missing = math.nan
    return {name for name in {*settings, *others} if settings.get(name, missing) != others.get(name, missing)}
