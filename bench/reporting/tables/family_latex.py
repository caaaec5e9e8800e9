"""A family's accuracy at one noise level for an article: a line a row, the bases side by side."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from bench.reporting.family import Family, FamilyRow, Section
from bench.reporting.frame import group
from bench.reporting.tables.family_numbers import ACCURACY, PLACE, accuracy_cells
from bench.reporting.tables.render import latex_tables

HEADS = ("n", *ACCURACY.values())


def latex(title: str, family: Family) -> str:
    """The table; rows of no base stand in the columns of the first."""
    headers = ["", *(f"{base}: {name}" if not i else name for base in family.bases for i, name in enumerate(HEADS))]
    rows: list[list[str]] = []
    for heading, sections in group(family.every, lambda section: section.heading).items():
        rows += [[heading, *[""] * (len(headers) - 1)], *_beside(tuple(family.bases), sections)]
    caption = f"{title} ({PLACE[0]:g} dB, initial state {PLACE[1]}). Root mean square errors over the Cramér-Rao bound."
    return latex_tables([(caption, (rows, headers))])


def _beside(bases: Sequence[str], sections: Iterable[Section]) -> Iterable[list[str]]:
    """The rows of a heading by title, and the numbers around each base."""
    columns: Mapping[str, dict[str, FamilyRow]] = {base: {} for base in bases}
    for section in sections:
        column = columns[section.base if section.base in columns else bases[0]]
        column.update({row.title: row for row in section.rows})
    for title in dict.fromkeys(title for column in columns.values() for title in column):
        yield [f"- {title}", *(cell for column in columns.values() for cell in _cells(column.get(title)))]


def _cells(row: FamilyRow | None) -> list[str]:
    if row is None:
        return [""] * len(HEADS)
    one = row.member.at(PLACE)
    return [f"{one.n_ok}/{one.n}" if one else "-", *accuracy_cells(one)]
