"""The table of a family: variants of one method, one thing changed at a time around each base, in sections.

It stands for an experiment whose ``table`` has the form ``family`` (:mod:`bench.reporting.family`).
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from bench.reporting.family import Family, FamilyRow, Member, Place, Section, any_stored, family_of
from bench.reporting.frame import Frame, Result
from bench.reporting.tables.family_latex import latex
from bench.reporting.tables.family_numbers import (
    ACCURACY,
    MISSING,
    NEAR,
    PLACE,
    TRAINING,
    accuracy,
    accuracy_cells,
    text,
    training,
)
from bench.reporting.tables.family_product import combinations
from bench.reporting.tables.family_sentences import sentences
from bench.reporting.tables.family_sources import sources
from bench.reporting.tables.render import Line, Rows, csv, failure_notes, markdown_table
from bench.scoring.traces import MOMENTS

LEGEND = """A row is one way of training the network on the same data. It differs from a base in one thing.
{bases} The base is the first row of each section. A row may stand in two sections.
Slow rows have fewer data sets, the first of the same: below the base stands what it does on those alone.

**Accuracy.** n: fits that gave an answer, of all; where the noise levels differ, one after the other. k/m, c/m, x
(displacement): root mean square error over the Cramér-Rao bound: 1 is the best an unbiased method can do. It is over
the fits that gave an answer. 95 %: the share of the 95 % intervals of k/m that held the truth, in percent.

**Training** ({place}). Medians over the fits; a failed fit counts as infinite. Times are processor seconds.

- *loss at end / minimum*: the loss where the training stopped, over the lowest that is known of the same loss.
- *certificate*: length of the gradient at the end, over those of Jacobian and residual. It is zero at a minimum.
- *s to within 1 % of the minimum*: when the loss came so near for good. The median is over the fits that did; behind
  it stands how many did, where not all.
- *s to {near:g} × oracle*: from when on the error of k/m stays within {near:g} times the oracle's on the same data,
  both root mean square. It is read off at {moments} fixed moments from {first:g} s to {last:g} s.
- *k/m at minimum*, *c/m at minimum*: the error over the bound, had each training ended at the minimum of its own loss;
  on the data sets that all rows of the section have.
- *whole fit s*: with the start scan, the intervals and all else. *memory*: by how much the process grew.

A dash: the method tells no such thing."""


def family_table(frame: Frame) -> Mapping[str, str]:
    """The files of the table by name; none where the store holds no cell of the family."""
    if not any_stored(frame):
        return {}
    family = family_of(frame)
    return {
        f"{family.method}.md": markdown(frame, family),
        f"{family.method}.csv": csv(lines(family), 5),
        f"{family.method}.tex": latex(frame.title, family),
    }


# ---- the tidy table


def lines(family: Family) -> list[Line]:
    """One line a row, cell and quantity; a cell that is not computed has n = 0 and the quantities of accuracy."""
    sections = (*family.every, family.combinations)
    return [line for section in sections for row in section.rows for line in _lines(family, section, row)]


def _lines(family: Family, section: Section, row: FamilyRow) -> Iterable[Line]:
    member = row.member
    for place in family.places:
        one = member.at(place)
        values = (
            {**accuracy(one), **training(one, _oracle(family, place), section.common(place))}
            if one
            else dict.fromkeys(ACCURACY, float("nan"))
        )
        for quantity, value in values.items():
            if value == value or quantity in ACCURACY:
                yield {
                    "section": section.heading, "base": section.base, "row": row.title, "method": member.method,
                    "settings": json.dumps(dict(member.settings), sort_keys=True), "snr_db": place[0],
                    "initial_state": place[1], "quantity": quantity, "value": value,
                    "n_ok": one.n_ok if one else 0, "n": one.n if one else 0,
                }  # fmt: skip


def _oracle(family: Family, place: Place) -> Result | None:
    return next((row.member.at(place) for row in family.references.rows if row.member.method == "oracle"), None)


# ---- for reading


def markdown(frame: Frame, family: Family) -> str:
    """Sentences, legend, and for each section the accuracy at either start and the training."""
    parts = [
        f"# {frame.title}",
        "\n".join(f"- {sentence}" for sentence in sentences(family, PLACE)),
        _legend(family),
        f"Regenerate: `python -m bench -m experiment={frame.experiment}`, then `python -m bench tables`.",
    ]
    for section in family.every:
        parts += _section(family, section)
    parts += combinations(family)
    parts += ["## Sources", sources(family)]
    notes = failure_notes(_unique(family))
    parts += ["## What failed", notes] if notes else []
    return "\n\n".join(parts) + "\n"


def _legend(family: Family) -> str:
    bases = " ".join(f"*{name.capitalize()}*: {words}." for name, words in family.bases.items())
    place = f"{PLACE[0]:g} dB, start {PLACE[1]}"
    ends = {"moments": len(MOMENTS), "first": MOMENTS[0], "last": MOMENTS[-1]}
    return LEGEND.format(bases=bases, place=place, near=NEAR, **ends)


def _section(family: Family, section: Section) -> Iterable[str]:
    yield f"## {section.heading}" + (f", {section.base}" if section.base else "")
    for start in dict.fromkeys(start for _, start in family.places):
        levels = [place for place in family.places if place[1] == start]
        yield f"*Accuracy, start {start}*"
        yield markdown_table(*_accuracy(section, levels))
    yield f"*Training ({PLACE[0]:g} dB, start {PLACE[1]})*"
    yield markdown_table(*_training(section, _oracle(family, PLACE)))


def _title(row: FamilyRow) -> str:
    return f"{row.title} (base)" if row.base else row.title


def _accuracy(section: Section, levels: Sequence[Place]) -> Rows:
    """A line a row, and side by side the noise levels."""
    headers = ["row", "n"]
    for snr, _ in levels:
        headers += [f"{snr:g} dB: {name}" if not i else name for i, name in enumerate(ACCURACY.values())]
    rows = []
    for row in section.rows:
        cells = [cell for place in levels for cell in accuracy_cells(row.member.at(place))]
        rows.append([_title(row), _counts(row.member, levels), *cells])
        if row.base:
            rows += [_base_on_fewer(row.member, n, levels) for n in _fewer(section, levels)]
    return rows, headers


def _fewer(section: Section, levels: Sequence[Place]) -> list[int]:
    """The numbers of data sets that rows have where the base has more, the largest first."""
    base = section.rows[0].member
    pairs = [(row.member.at(at), base.at(at)) for row in section.rows[1:] for at in levels]
    return sorted({one.n for one, other in pairs if one and other and one.n < other.n}, reverse=True)


def _base_on_fewer(base: Member, n: int, levels: Sequence[Place]) -> list[str]:
    """The line of the base on its first n data sets; a dash at noise levels where it has no more."""
    cells: list[str] = []
    for at in levels:
        one = base.at(at)
        cells += accuracy_cells(one, n) if one and one.n > n else ["-", *[""] * (len(ACCURACY) - 1)]
    return [f"the base on {n} data sets", str(n), *cells]


def _counts(member: Member, levels: Sequence[Place]) -> str:
    """Fits that gave an answer, of all: once where it is the same at every noise level that is computed."""
    counts = [f"{one.n_ok}/{one.n}" if (one := member.at(place)) else "-" for place in levels]
    computed = set(counts) - {"-"}
    return ", ".join(counts) if len(computed) > 1 else next(iter(computed), "-")


def _training(section: Section, oracle: Result | None) -> Rows:
    rows, n = [], section.common(PLACE)
    for row in section.rows:
        one = row.member.at(PLACE)
        cells = _training_cells(one, oracle, n) if one else ["-", MISSING, *[""] * (len(TRAINING) - 1)]
        rows.append([_title(row), *cells])
    return rows, ["row", "n", *TRAINING.values()]


def _training_cells(one: Result, oracle: Result | None, n: int) -> list[str]:
    values = training(one, oracle, n)
    cells = {name: text(name, values[name]) for name in TRAINING}
    if 0 < values["arrived_share"] < 1:
        cells["arrival_s"] += f" ({round(values['arrived_share'] * one.n)}/{one.n})"
    return [f"{one.n_ok}/{one.n}", *cells.values()]


def _unique(family: Family) -> list[Result]:
    """Every cell once, under the name of its row."""
    return [replace(cell, label=member.name) for member in family.members for cell in member.cells.values()]
