"""What a practitioner can take from a family's table: sentences whose numbers are worked out, none typed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from bench.reporting.family import Family, FamilyRow, Member, Place, Section
from bench.reporting.tables.family_numbers import GROUP, OTHER, arrival, at_minimum, text
from bench.reporting.tables.pooling import pooled_errors
from bench.scoring.comparison import Comparison, Errors, adjusted, compare

OPTIMIZER, WEIGHTING = "optimizer", "weighting"
HALF = 0.5
"""An optimiser whose share of fits that come to the minimum is larger is said to reach it."""


def sentences(family: Family, place: Place) -> list[str]:
    """On optimisers and on weightings in one scenario, and on errors in all of them."""
    return [optimisers(family, place), weightings(family, place), errors(family)]


# ---- optimisers


def optimisers(family: Family, place: Place) -> str:
    """Which reach the minimum on each base's loss, and in how many seconds; whether the last base's own does."""
    sections = [one for base in range(len(family.bases)) if (one := family.section(OPTIMIZER, base))]
    if not sections:
        return "No optimisers are compared."
    known = {section.base: _arrivals(section, place) for section in sections}
    said = [_who_arrives(section, known[section.base], place) for section in sections]
    return " ".join([*said, _own(sections[-1], known)])


Arrival = tuple[FamilyRow, float, float]
"""A row, the share of its fits that reach the minimum, and the median time of these (s)."""


def _arrivals(section: Section, place: Place) -> list[Arrival]:
    """Those of the rows that are computed and tell the way of their training, the fastest first."""
    found = [(row, *arrival(one)) for row in section.rows if (one := row.member.at(place))]
    return sorted((one for one in found if not math.isnan(one[1])), key=lambda one: one[2])


def _who_arrives(section: Section, known: Sequence[Arrival], place: Place) -> str:
    missing = _missing(section.rows, place)
    if not known:
        return f"Which optimisers reach the minimum on {section.base} is not known.{missing}"
    there = [f"{row.title} in {text('arrival_s', seconds)} s" for row, share, seconds in known if share > HALF]
    listed = f", first {there[0]}" + (f", last {there[-1]}" if there[1:] else "") if there else ""
    first = f"{len(there)} of {len(known)} optimisers come within 1 % of the minimum in most of their fits"
    return f"On {section.base} {first}{listed}.{missing}"


def _own(section: Section, known: Mapping[str, Sequence[Arrival]]) -> str:
    """How long a base's own optimiser takes, beside the fastest of all."""
    title = section.rows[0].title
    own = next((one for one in known[section.base] if one[0].base), None)
    if own is None:
        return f"How long {section.base} itself ({title}) takes is not known: its cell is not computed."
    _, share, seconds = own
    if math.isinf(seconds):
        return f"In no fit does {section.base} itself ({title}) get there."
    least, fastest = min((one[2], f"{one[0].title} on {base}") for base, each in known.items() for one in each)
    times = f": {seconds / least:.3g} times as long as {fastest}" if least < seconds else ""
    return (
        f"By {section.base} itself ({title}) {100 * share:.0f} % of the fits get there, in "
        f"{text('arrival_s', seconds)} s{times}."
    )


# ---- weightings


def weightings(family: Family, place: Place) -> str:
    """Whose own minimum is nearest the bound, and where that of the others lies."""
    section = family.section(WEIGHTING, 0)
    if section is None:
        return "No weightings are compared."
    own = {row: one for row in section.rows if (one := row.member.at(place))}
    n = section.common(place)
    found = {row: at for row, one in own.items() if not math.isnan(sum(at := at_minimum(one, n)))}
    missing = _missing(section.rows, place)
    if not found:
        return f"Which weighting's own minimum is nearest the bound is not known.{missing}"
    ranked = sorted(found, key=lambda row: abs(math.log(max(math.hypot(*found[row]) / math.sqrt(2.0), 1e-300))))
    first, *others = [f"{row.title} ({', '.join(text('excess', one) for one in found[row])})" for row in ranked]
    chance = 100.0 / math.sqrt(2.0 * n)
    behind = f"; then {others[0]}" + (f"; last {others[-1]}" if others[1:] else "") if others else ""
    return (
        f"Of {len(found)} weightings on {section.base}, the one whose own minimum is nearest the bound is {first}"
        f"{behind}. In brackets: the errors of k/m and c/m there over the bound on the same {n} data sets, each "
        f"uncertain by about {chance:.0f} %.{missing}"
    )


# ---- errors


def errors(family: Family) -> str:
    """Whether any member's errors are less than the first base's, beyond chance."""
    base = next((s.rows[0] for setting in (OPTIMIZER, WEIGHTING) if (s := family.section(setting, 0))), None)
    if base is None:
        return "No errors are compared."
    rows = (row for section in (*family.sections, family.combinations, family.others) for row in section.rows)
    others = [member for member in dict.fromkeys(row.member for row in rows) if member is not base.member]
    found = [(member, c) for member in others if (c := against(member, base.member, family.places))]
    missing = _uncomputed(len(others) - len(found), len(others))
    name = f"{base.title} ({next(iter(family.bases))})"
    if not found:
        return f"Whether any row beats {name} in error is not known.{missing}"
    together = list(zip((member for member, _ in found), adjusted([c for _, c in found]), strict=True))
    better = [f"{m.name} (median ratio of errors {c.ratio:.2f})" for m, c in together if not c.tie and c.ratio < 1.0]
    worse = sum(not c.tie and c.ratio > 1.0 for _, c in together)
    sets = _span(sorted(paired(member, base.member, family.places)[1].size for member, _ in found))
    verb = f"{len(better)} of {len(found)} rows beat" if better else f"None of {len(found)} rows beats"
    winners = f": {'; '.join(better)}" if better else ""
    return (
        f"{verb} {name} in the errors of k/m and c/m together beyond chance{winners}. Worse beyond chance: {worse}; "
        f"not told from it: {len(found) - len(better) - worse} ({sets} common data sets; Wilcoxon's signed-rank test, "
        f"Holm's adjustment, 5 %; less than 2 % apart is a tie).{missing}"
    )


def paired(one: Member, other: Member, places: Iterable[Place]) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Root mean squares of error over bound of k/m and c/m on the data sets that two members have in common.

    Of each member (n,), infinite where it failed; and the scenario of each data set (n,).
    """
    pairs = [(a, b) for at in places if (a := one.at(at)) and (b := other.at(at))]
    n = min((min(a.n, b.n) for a, b in pairs), default=0)
    columns = [[pooled_errors(own, (GROUP, OTHER))[:n] for own in side] for side in zip(*pairs, strict=True)] or [
        [],
        [],
    ]
    first, second = (np.concatenate(side) if side else np.empty(0) for side in columns)
    return (first, second), np.repeat(np.arange(len(pairs)), n)


def against(one: Member, other: Member, places: Sequence[Place]) -> Comparison | None:
    """Two members compared; None without a common data set."""
    (first, second), scenario = paired(one, other, places)
    if not scenario.size:
        return None
    return compare(Errors({"row": first, "base": second}, scenario), [("row", "base")])[0]


# ---- words


def _missing(rows: Sequence[FamilyRow], place: Place) -> str:
    return _uncomputed(sum(row.member.at(place) is None for row in rows), len(rows))


def _uncomputed(missing: int, of: int) -> str:
    return f" {missing} of {of} rows are not computed." if missing else ""


def _span(counts: Sequence[int]) -> str:
    return f"{counts[0]}" if counts[0] == counts[-1] else f"{counts[0]} to {counts[-1]}"
