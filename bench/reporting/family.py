"""The read model of a family: the variants of one method, each one thing apart from a base, in sections.

The family is the method of an experiment whose card has choices. The experiment's ``table`` names the ``bases`` (what
each has not at its default), the ``factors`` (settings by heading), the ``references``, and the ``names`` of values
that have none on the card. A variant stands in the section of the factor and base that it is one setting apart from;
it may stand in several. What differs in several of the settings that ``product`` names is one of their combinations.
"""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bench.contract.method import Card
from bench.entrants.registry import default_settings
from bench.errors import InputError
from bench.reporting.frame import Frame, Result, group
from bench.reporting.labels import cards, title

Place = tuple[float, str]
"""Noise level (dB) and reading of the initial state."""


def changed_settings(one: Result) -> dict[str, Any]:
    """The settings of a result that are not at their defaults; all of them where its method is not installed here."""
    try:
        usual = default_settings(one.method)
    except InputError:
        return dict(one.settings)
    return {name: value for name, value in one.settings.items() if name not in usual or usual[name] != value}


def has_choices(method: str) -> bool:
    """Whether a method is a family."""
    card = cards().get(method)
    return card is not None and bool(card.choices)


def any_stored(frame: Frame) -> bool:
    """Whether any cell of a family is stored."""
    return any(one.stored and has_choices(one.method) for one in frame)


def is_variant(one: Result) -> bool:
    """Whether a result is a variant of a family, which stands in the family's table and picture alone."""
    return has_choices(one.method) and one.label != one.method


@dataclass(frozen=True, eq=False)
class Member:
    """A method with its settings in all scenarios; ``settings`` are those not at their defaults."""

    method: str
    name: str
    settings: Mapping[str, Any]
    cells: Mapping[Place, Result]

    def at(self, place: Place) -> Result | None:
        """The cell of a scenario where it is stored."""
        found = self.cells.get(place)
        return found if found and found.stored else None


@dataclass(frozen=True)
class FamilyRow:
    """A member as a section calls it; ``base``: what the others of the section are compared with."""

    title: str
    member: Member
    base: bool = False


@dataclass(frozen=True)
class Section:
    """Rows that belong together: those of a factor around a base, or those of neither."""

    heading: str
    base: str
    settings: tuple[str, ...]
    rows: tuple[FamilyRow, ...]

    def common(self, place: Place) -> int:
        """How many data sets all rows have that are computed there: the first of the same."""
        return min((one.n for row in self.rows if (one := row.member.at(place))), default=0)


@dataclass(frozen=True)
class Family:
    """All sections; ``places`` are the scenarios in order, ``bases`` what each base is in words.

    ``combinations`` are the variants that differ from every base in several of its ``settings`` and in no other.
    """

    method: str
    places: tuple[Place, ...]
    bases: Mapping[str, str]
    references: Section
    sections: tuple[Section, ...]
    combinations: Section
    others: Section
    members: tuple[Member, ...]
    names: Names

    def section(self, setting: str, base: int) -> Section | None:
        """The section that varies a setting around the first or the second base."""
        names = list(self.bases)
        wanted = names[base] if base < len(names) else ""
        return next((one for one in self.sections if setting in one.settings and one.base == wanted), None)

    @property
    def every(self) -> tuple[Section, ...]:
        """All sections that have rows, in order."""
        return tuple(one for one in (self.references, *self.sections, self.others) if one.rows)


def family_of(frame: Frame) -> Family:
    """The family of an experiment; raises InputError where none of its methods has choices."""
    method = next((one.method for one in frame if has_choices(one.method)), None)
    if method is None:
        raise InputError("table.form", "family", "an experiment with a method whose card has choices")
    names = Names(cards()[method], frame.table.get("names", {}), default_settings(method))
    members = _members(frame, method, names)
    own = [member for member in members if member.method == method]
    wanted = list(map(str, frame.table.get("references", [])))
    references = [FamilyRow(m.name, m) for name in wanted for m in members if m.method == name]
    others = [FamilyRow(m.name, m) for m in members if m.method not in (method, *wanted)]
    stated: Mapping[str, Mapping[str, Any]] = frame.table.get("bases", {"base": {}})
    product = tuple(map(str, frame.table.get("product", [])))
    bases = {name: {s: v for s, v in own.items() if names.usual.get(s) != v} for name, own in stated.items()}
    near = list(_sections(own, bases, frame.table.get("factors", {}), names, method))
    left = _left(own, bases.values(), near)
    combined = [member for member in left if set(member.settings) <= set(product)]
    return Family(
        method=method,
        places=tuple(sorted({place(one): None for one in frame}, key=lambda at: at[1])),
        bases={base: names.whole(settings) for base, settings in bases.items()},
        references=Section("Reference rows", "", (), tuple(references)),
        sections=(*near, *_several([one for one in left if one not in combined], frame.table.get("factors", {}))),
        combinations=Section("Combinations", "", product, tuple(FamilyRow(one.name, one) for one in combined)),
        others=Section("Other packages", "", (), tuple(others)),
        members=tuple(members),
        names=names,
    )


def place(one: Result) -> Place:
    """Where a result stands."""
    return one.snr_db, one.initial_state


@dataclass(frozen=True)
class Names:
    """What values of settings are called: on the card, else in the experiment, else by setting and value."""

    card: Card
    more: Mapping[str, Any]
    usual: Mapping[str, Any]

    def of(self, setting: str, value: Any) -> str:
        """The name of a value."""
        choice = self.card.choices.get(setting, {}).get(str(value))
        if choice:
            return choice.title
        own = self.more.get(setting, {})
        if isinstance(own, str):
            return own.format(value)
        return str(own.get(str(value), f"{setting.replace('_', ' ')} {value}"))

    def order(self, setting: str, value: Any) -> float:
        """The place of a value among those of its setting: as the card has them, numbers by size."""
        known = list(self.card.choices.get(setting, {}))
        if str(value) in known:
            return float(known.index(str(value)))
        return float(value) if isinstance(value, int | float) else math.inf

    def together(self, settings: Mapping[str, Any]) -> str:
        """The names of several values."""
        return "; ".join(self.of(setting, value) for setting, value in settings.items())

    def whole(self, settings: Mapping[str, Any]) -> str:
        """The names of all choices of a variant, and of what else is not at its default."""
        return self.together({**{setting: self.usual[setting] for setting in self.card.choices}, **settings})


def _members(frame: Frame, method: str, names: Names) -> list[Member]:
    """Every method with its settings, its cells by scenario: stored ones first, then those of most replicates."""
    found = []
    grouped = group(frame, lambda one: (one.method, json.dumps(changed_settings(one), sort_keys=True, default=str)))
    for (name, _), results in grouped.items():
        cells: dict[Place, Result] = {}
        for one in sorted(results, key=lambda own: -own.n):
            cells.setdefault(place(one), one)
        settings = changed_settings(results[0])
        called = names.together(settings) or names.whole({}) if name == method else _called(results[0], settings)
        found.append(Member(name, called, settings, cells))
    return found


def _called(one: Result, settings: Mapping[str, Any]) -> str:
    """A method that is not of the family: by its card, else by its method's and what is not at its default."""
    if one.label in cards():
        return one.title
    return "; ".join([title(one.method), *(f"{name.replace('_', ' ')} {value}" for name, value in settings.items())])


def _sections(
    members: Sequence[Member],
    bases: Mapping[str, Mapping[str, Any]],
    factors: Mapping[str, Sequence[str]],
    names: Names,
    method: str,
) -> Iterable[Section]:
    """A section a factor and base that has more than its base."""
    for heading, settings in factors.items():
        for base, usual in bases.items():
            near = _near(members, usual, settings, names)
            first = next((m for m in members if not apart(m.settings, usual)), Member(method, base, usual, {}))
            if near:
                called = names.together({setting: usual.get(setting, names.usual.get(setting)) for setting in settings})
                yield Section(heading, base, tuple(settings), (FamilyRow(called, first, True), *near))


def _left(members: Sequence[Member], bases: Collection[Mapping[str, Any]], sections: Iterable[Section]) -> list[Member]:
    """The members that are no base and stand in no section."""
    placed = {row.member for section in sections for row in section.rows}
    return [one for one in members if one not in placed and all(apart(one.settings, base) for base in bases)]


def _several(members: Sequence[Member], factors: Mapping[str, Sequence[str]]) -> Iterable[Section]:
    """Sections of what is more than one setting from every base."""
    for heading, own in group(members, lambda member: _heading(member, factors)).items():
        yield Section(heading, "several settings at once", (), tuple(FamilyRow(member.name, member) for member in own))


def _near(members: Sequence[Member], base: Mapping[str, Any], settings: Sequence[str], names: Names) -> list[FamilyRow]:
    """The members that differ from a base in one of these settings alone, in the order of its values."""
    found = []
    for member in members:
        different = apart(member.settings, base)
        if len(different) == 1 and different <= set(settings):
            setting = different.pop()
            value = member.settings.get(setting, names.usual.get(setting))
            found.append(
                (settings.index(setting), names.order(setting, value), FamilyRow(names.of(setting, value), member))
            )
    return [row for _, _, row in sorted(found, key=lambda one: one[:2])]


def _heading(member: Member, factors: Mapping[str, Sequence[str]]) -> str:
    """The last factor of which a member has something changed."""
    own = [heading for heading, settings in factors.items() if set(settings) & set(member.settings)]
    return own[-1] if own else "Other settings"


def apart(one: Mapping[str, Any], other: Mapping[str, Any]) -> set[str]:
    """The settings in which two variants differ, each given by what it has not at its default."""
    missing = math.nan
    return {name for name in {*one, *other} if one.get(name, missing) != other.get(name, missing)}
