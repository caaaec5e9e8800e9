"""The table of a family: variants of one method, one thing changed at a time around each base, in sections.

It stands for an experiment whose ``table`` has the form ``family`` (:mod:`bench.reporting.family`).
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product

from bench.reporting.family import Family, FamilyRow, Member, Place, Section, any_stored, family_of
from bench.reporting.frame import Frame, Line, Result, group
from bench.reporting.rounding import answered
from bench.reporting.tables.family_numbers import (
    ACCURACY,
    GROUP,
    MISSING,
    NEAR,
    OTHER,
    PLACE,
    TRAINING,
    accuracy,
    median,
    text,
    training,
)
from bench.reporting.tables.family_sources import sources
from bench.reporting.tables.render import Columns, Rows, failure_notes, files, listing, panel
from bench.scoring.traces import MOMENTS

COLUMNS = (
    "section", "base", "row", "method", "settings", "snr_db", "initial_state", "quantity", "value", "n_ok", "n",
)  # fmt: skip
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
    every = [replace(cell, label=member.name) for member in family.members for cell in member.cells.values()]
    notes = failure_notes(every)
    parts: list[str | Rows] = [
        f"# {frame.title}",
        _legend(family),
        f"Regenerate: `python -m bench -m experiment={frame.experiment}`, then `python -m bench tables`.",
        *(part for section in family.every for part in _section(family, section)),
        *_combinations(family),
        "## Sources",
        sources(family),
        *(["## What failed", notes] if notes else []),
    ]
    caption = f"({PLACE[0]:g} dB, initial state {PLACE[1]}). Root mean square errors over the Cramér-Rao bound."
    latex = [(f"{_heading(section)} {caption}", _accuracy(section, [PLACE])) for section in family.every]
    return files(family.method, parts, lines(family), COLUMNS, 5, latex)


# ---- the tidy table


def lines(family: Family) -> list[Line]:
    """One line a row, cell and quantity; a cell that is not computed has n = 0 and the quantities of accuracy."""
    sections = (*family.every, family.combinations)
    return [
        line
        for section in sections
        for row in section.rows
        for place in family.places
        for line in _lines(family, section, row, place)
    ]


def _lines(family: Family, section: Section, row: FamilyRow, place: Place) -> Iterator[Line]:
    member, one = row.member, row.member.at(place)
    head = {
        "section": section.heading, "base": section.base, "row": row.title, "method": member.method,
        "settings": json.dumps(dict(member.settings), sort_keys=True), "snr_db": place[0], "initial_state": place[1],
        "n_ok": one.n_ok if one else 0, "n": one.n if one else 0,
    }  # fmt: skip
    values = dict.fromkeys(ACCURACY, float("nan"))
    if one:
        values = {**accuracy(one), **training(one, _oracle(family, place), section.common(place))}
    for quantity, value in values.items():
        if value == value or quantity in ACCURACY:
            yield {**head, "quantity": quantity, "value": value}


def _oracle(family: Family, place: Place) -> Result | None:
    return next((row.member.at(place) for row in family.references.rows if row.member.method == "oracle"), None)


# ---- for reading


def _legend(family: Family) -> str:
    bases = " ".join(f"*{name.capitalize()}*: {words}." for name, words in family.bases.items())
    place = f"{PLACE[0]:g} dB, start {PLACE[1]}"
    ends = {"moments": len(MOMENTS), "first": MOMENTS[0], "last": MOMENTS[-1]}
    return LEGEND.format(bases=bases, place=place, near=NEAR, **ends)


def _section(family: Family, section: Section) -> Iterator[str | Rows]:
    """The accuracy at either start, and the training."""
    yield f"## {_heading(section)}"
    for start, places in group(family.places, lambda place: place[1]).items():
        yield f"*Accuracy, start {start}*"
        yield _accuracy(section, places)
    yield f"*Training ({PLACE[0]:g} dB, start {PLACE[1]})*"
    titles: Columns[FamilyRow] = {"row": _title, "n": lambda row: _counts(row.member, [PLACE])}
    oracle, n = _oracle(family, PLACE), section.common(PLACE)
    columns = {heading: partial(_training, name, oracle, n) for name, heading in TRAINING.items()}
    yield listing(section.rows, {**titles, **columns})


def _heading(section: Section) -> str:
    return section.heading + (f", {section.base}" if section.base else "")


def _title(row: FamilyRow) -> str:
    return f"{row.title} (base)" if row.base else row.title


def _counts(member: Member, places: Sequence[Place]) -> str:
    """Fits that gave an answer, of all: once where it is the same at every noise level that is computed."""
    counts = [answered(one.n_ok, one.n) if (one := member.at(place)) else "-" for place in places]
    computed = set(counts) - {"-"}
    return ", ".join(counts) if len(computed) > 1 else next(iter(computed), "-")


def _accuracy(section: Section, places: Sequence[Place]) -> Rows:
    """A line a row, and side by side the noise levels; below the base what it does on fewer data sets."""
    cells: list[Line] = []
    for row in section.rows:
        head: Line = {"row": _title(row), "n": _counts(row.member, places), "missing": MISSING}
        cells += [{**head, "place": place, "values": _values(row.member.at(place))} for place in places]
        for n in _fewer(section, places) if row.base else ():
            head = {"row": f"the base on {n} data sets", "n": str(n), "missing": "-"}
            on_fewer = {place: one for place in places if (one := row.member.at(place)) and one.n > n}
            cells += [{**head, "place": place, "values": _values(on_fewer.get(place), n)} for place in places]
    return panel(
        cells,
        lambda cell: {"row": cell["row"], "n": cell["n"]},
        lambda cell: {
            f"{cell['place'][0]:g} dB: {name}": _entry(quantity, cell) for quantity, name in ACCURACY.items()
        },
    )


def _values(one: Result | None, n: int | None = None) -> dict[str, float]:
    return accuracy(one, n) if one else {}


def _entry(quantity: str, cell: Line) -> str:
    if not cell["values"]:
        return str(cell["missing"]) if quantity == next(iter(ACCURACY)) else ""
    return text(quantity, cell["values"][quantity])


def _fewer(section: Section, places: Sequence[Place]) -> list[int]:
    """The numbers of data sets that rows have where the base has more, the largest first."""
    base = section.rows[0].member
    pairs = [(row.member.at(at), base.at(at)) for row in section.rows[1:] for at in places]
    return sorted({one.n for one, other in pairs if one and other and one.n < other.n}, reverse=True)


def _training(name: str, oracle: Result | None, n: int, row: FamilyRow) -> str:
    one = row.member.at(PLACE)
    if one is None:
        return MISSING if name == next(iter(TRAINING)) else ""
    values = training(one, oracle, n)
    share = values["arrived_share"]
    some = name == "arrival_s" and 0 < share < 1
    return text(name, values[name]) + (f" ({round(share * one.n)}/{one.n})" if some else "")


# ---- what settings do together


def _combinations(family: Family) -> list[str | Rows]:
    """The errors of all combinations of settings on the same data sets; nothing where none were combined.

    A line a value of all settings but the second, whose values stand side by side.
    """
    settings, names = family.combinations.settings, family.names
    if len(settings) < 2 or not family.combinations.rows:
        return []
    members = {
        tuple(member.settings.get(name, names.usual[name]) for name in settings): member
        for member in family.members
        if member.method == family.method and set(member.settings) <= set(settings)
    }
    n = min((one.n for member in members.values() if (one := member.at(PLACE))), default=0)
    combined = [
        [row.member.settings.get(name, names.usual[name]) for row in family.combinations.rows] for name in settings
    ]
    values = [sorted(set(own), key=partial(names.order, name)) for name, own in zip(settings, combined, strict=True)]
    words = [setting.replace("_", " ") for setting in settings]

    def entry(combination: tuple[object, ...]) -> str:
        """Both errors and the time; what is missing is said."""
        member = members.get(combination)
        one = member.at(PLACE) if member else None
        if one is None:
            return MISSING
        found = accuracy(one, n)
        both = ", ".join(text(f"{name}_excess", found[f"{name}_excess"]) for name in (GROUP, OTHER))
        return f"{both} ({text('fit_s', median(one.cpu_s))} s)"

    down = [0, *range(2, len(settings))]
    table = panel(
        sorted(product(*values), key=lambda one: [values[i].index(one[i]) for i in down]),
        lambda one: {words[i]: names.of(settings[i], one[i]) for i in down},
        lambda one: {names.of(settings[1], one[1]): entry(one)},
    )
    explanation = (
        f"Errors of k/m and c/m over the bound on the first {n} data sets ({PLACE[0]:g} dB, start {PLACE[1]}), and "
        "processor seconds of a whole fit."
    )
    return [f"## All combinations of {', '.join(words)}", explanation, table]
