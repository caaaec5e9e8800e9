"""The table of a family: variants of one method, one thing changed at a time around each base, in sections.

It stands for an experiment whose ``table`` has the form ``family`` (:mod:`bench.reporting.family`).
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, partial
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from typing import Any

import numpy as np

from bench.entrants.registry import load_method
from bench.reporting.family import PLACE, Family, Place, Section, Variant, any_stored, family_of
from bench.reporting.frame import ERROR, Frame, Line, Result, group
from bench.reporting.labels import cards
from bench.reporting.rounding import answered, excess_text, number, percent
from bench.reporting.tables.pooling import root_mean_square
from bench.reporting.tables.render import MISSING, Columns, Panel, Rows, Texts, failure_notes, files, listing
from bench.scoring.traces import MOMENTS

STIFFNESS, DAMPING = "k_over_m", "c_over_m"
NEAR = 1.1
"""So many times the oracle's error is as good as the oracle."""
CSV = (
    "section", "base", "row", "method", "settings", "snr_db", "initial_state", "quantity", "value", "n_ok", "n",
)  # fmt: skip
LEGEND = """A row is one way of training the network on the same data. It differs from a base in one thing.
{bases} The base is the first row of each section. A row may stand in two sections.
Slow rows have fewer data sets, the first of the same: below the base stands what it does on those alone.

**Accuracy.** n: fits that gave an answer, of all; where the noise levels differ, one after the other. k/m, c/m, x
(displacement): root mean square error over the Cramér-Rao bound: 1 is the best an unbiased method can do. It is over
the fits that gave an answer. 95 %: the share of the 95 % intervals of k/m that cover the true value, in percent.

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

A dash: not computed, or the method has no such thing."""


# ---- what is said of one cell


@dataclass(frozen=True)
class FamilyColumn:
    """A column: its heading (none: in the CSV alone), its value by cell, data sets (None: all) and oracle, its text."""

    heading: str
    value: Callable[[Result, int | None, Result | None], float]
    text: Callable[[float], str] = number


def _excess(metric: str, score: str, heading: str) -> FamilyColumn:
    """The root mean square of a score over the bound of a metric, over the successful of the first n fits."""
    return FamilyColumn(
        heading, lambda cell, n, _: root_mean_square(cell.successful(score, n)) / cell.bound(metric), excess_text
    )


def _median(score: str, heading: str, text: Callable[[float], str] = number) -> FamilyColumn:
    return FamilyColumn(heading, lambda cell, n, _: cell.statistic(score, "median"), text)


def finite_median(values: np.ndarray) -> float:
    """The median of what is finite; NaN of nothing."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else math.nan


def _coverage(cell: Result, n: int | None, _: Result | None) -> float:
    hits = cell.successful(f"{STIFFNESS}_coverage_95", n)
    return float(np.mean(hits)) if hits.size else math.nan


def _memory(cell: Result, n: int | None, _: Result | None) -> float:
    return finite_median(cell.stored.columns.numbers("peak_memory_mb")) if cell.stored else math.nan


def arrived(cell: Result, n: int | None = None, _: Result | None = None) -> float:
    """The share of all fits that came within 1 % of their minimum for good; NaN where no minimum is known."""
    return cell.successful("arrival_s").size / cell.n if cell.successful("loss_over_minimum").size else math.nan


def arrival(cell: Result, n: int | None = None, _: Result | None = None) -> float:
    """The median time (s) to there of those that did; infinite where none did."""
    share = arrived(cell)
    return finite_median(cell.successful("arrival_s")) if share else math.inf if share == 0 else math.nan


def oracle_seconds(cell: Result, oracle: Result | None) -> float:
    """The first moment (s) from which on the error of k/m stays within 1.1 times the oracle's; infinite if never.

    Both are root mean squares over the same replicates, those in which both succeeded.
    """
    if oracle is None or not cell.successful("training_s").size:
        return math.nan
    n = min(cell.n, oracle.n)
    both = cell.ok[:n] & oracle.ok[:n]
    limit = NEAR * root_mean_square(oracle.scores(STIFFNESS + ERROR)[:n][both])
    errors = {moment: root_mean_square(cell.scores(moment_score(moment))[:n][both]) for moment in MOMENTS}
    late = [i for i, error in enumerate(errors.values()) if not error <= limit]
    return [*MOMENTS, math.inf][late[-1] + 1 if late else 0]


def moment_score(moment: float) -> str:
    """The score that has the error at a moment (s) of a training."""
    return f"{STIFFNESS}_off_pct_at_{moment:g}s"


def _seconds(value: float) -> str:
    return "never" if math.isinf(value) else number(value)


ACCURACY = {
    "k_over_m_excess": _excess(STIFFNESS + ERROR, STIFFNESS + ERROR, "k/m"),
    "c_over_m_excess": _excess(DAMPING + ERROR, DAMPING + ERROR, "c/m"),
    "displacement_excess": _excess("rmse", "rmse", "x"),
    "k_over_m_coverage_95": FamilyColumn("95 %", _coverage, percent),
}
"""The quantities of every cell."""
TRAINING = {
    "loss_over_minimum": _median(
        "loss_over_minimum", "loss at end / minimum", lambda loss: f"{loss:.3f}" if loss < 100 else number(loss)
    ),
    "certificate": _median("certificate", "certificate"),
    "training_s": _median("training_s", "training s"),
    "arrival_s": FamilyColumn("s to within 1 % of the minimum", arrival, _seconds),
    "arrived_share": FamilyColumn("", arrived),
    "oracle_s": FamilyColumn(f"s to {NEAR:g} × oracle", lambda cell, n, oracle: oracle_seconds(cell, oracle), _seconds),
    "k_over_m_excess_at_minimum": _excess(STIFFNESS + ERROR, f"{STIFFNESS}_off_pct_at_minimum", "k/m at minimum"),
    "c_over_m_excess_at_minimum": _excess(DAMPING + ERROR, f"{DAMPING}_off_pct_at_minimum", "c/m at minimum"),
    "fit_s": FamilyColumn("whole fit s", lambda cell, n, _: finite_median(cell.cpu_s)),
    "peak_memory_mb": FamilyColumn("memory MB", _memory, lambda size: MISSING if math.isnan(size) else f"{size:.0f}"),
}
"""The quantities of a training."""


# ---- the table


def family_table(frame: Frame) -> Mapping[str, str]:
    """The files of the table by name; none where the store holds no cell of the family."""
    if not any_stored(frame):
        return {}
    family = family_of(frame)
    notes = failure_notes(replace(cell, label=v.title) for v in family.variants for cell in v.cells.values())
    parts: list[str | Rows] = [
        f"# {frame.title}",
        _legend(family),
        frame.footer,
        *(part for section in family.sections for part in _section(family, section)),
        *_combinations(family),
        f"## Sources\n\n{_sources(family)}",
        f"## What failed\n\n{notes}" if notes else "",
    ]
    caption = f"({PLACE[0]:g} dB, initial state {PLACE[1]}). Root mean square errors over the Cramér-Rao bound."
    latex = [(f"{_heading(section)} {caption}", _accuracy(section, [PLACE])) for section in family.sections]
    return files(family.method, parts, _lines(family), CSV, 5, latex)


def _lines(family: Family) -> Iterator[Line]:
    """One line a row, cell and quantity; a cell that is not computed has n = 0 and the quantities of accuracy."""
    sections = [*family.sections, family.combinations]
    rows = [(section, row, place) for section in sections for row in section.rows for place in family.places]
    for section, row, place in rows:
        cell, oracle, n = row.at(place), _oracle(family, place), section.common(place)
        head = {
            "section": section.heading, "base": section.base, "row": row.title, "method": row.method,
            "settings": json.dumps(dict(row.settings), sort_keys=True), "snr_db": place[0], "initial_state": place[1],
            "n_ok": cell.n_ok if cell else 0, "n": cell.n if cell else 0,
        }  # fmt: skip
        for name, quantity in ACCURACY.items():
            yield {**head, "quantity": name, "value": quantity.value(cell, None, None) if cell else math.nan}
        for name, quantity in TRAINING.items() if cell else ():
            if not math.isnan(value := quantity.value(cell, n, oracle)):  # type: ignore[arg-type]
                yield {**head, "quantity": name, "value": value}


def _oracle(family: Family, place: Place) -> Result | None:
    return next((variant.at(place) for variant in family.variants if variant.method == "oracle"), None)


def _legend(family: Family) -> str:
    usual = {setting: family.names.usual[setting] for setting in family.names.card.choices}
    bases = (f"*{name.capitalize()}*: {family.names.joined({**usual, **own})}." for name, own in family.bases.items())
    ends = {"moments": len(MOMENTS), "first": MOMENTS[0], "last": MOMENTS[-1]}
    return LEGEND.format(bases=" ".join(bases), place=f"{PLACE[0]:g} dB, start {PLACE[1]}", near=NEAR, **ends)


def _heading(section: Section) -> str:
    return section.heading + (f", {section.base}" if section.base else "")


def _title(row: Variant) -> str:
    return f"{row.title} (base)" if row.base else row.title


def _section(family: Family, section: Section) -> Iterator[str | Rows]:
    """The accuracy at either start, and the training."""
    yield f"## {_heading(section)}"
    for start, places in group(family.places, lambda place: place[1]).items():
        yield f"*Accuracy, start {start}*"
        yield _accuracy(section, places)
    yield f"*Training ({PLACE[0]:g} dB, start {PLACE[1]})*"
    oracle, n = _oracle(family, PLACE), section.common(PLACE)
    columns: Columns[Variant] = {
        quantity.heading: partial(_training, quantity, n, oracle) for quantity in TRAINING.values() if quantity.heading
    }
    yield listing(section.rows, {"row": _title, "n": partial(_counts, [PLACE]), **columns})


def _training(quantity: FamilyColumn, n: int, oracle: Result | None, row: Variant) -> str:
    cell = row.at(PLACE)
    if cell is None:
        return MISSING
    some = quantity is TRAINING["arrival_s"] and 0 < arrived(cell) < 1
    return quantity.text(quantity.value(cell, n, oracle)) + (
        f" ({round(arrived(cell) * cell.n)}/{cell.n})" if some else ""
    )


def _counts(places: Sequence[Place], row: Variant) -> str:
    """Fits that gave an answer, of all: once where it is the same at every noise level that is computed."""
    counts = [answered(cell.n_ok, cell.n) if (cell := row.at(place)) else MISSING for place in places]
    computed = set(counts) - {MISSING}
    return ", ".join(counts) if len(computed) > 1 else next(iter(computed), MISSING)


def _accuracy(section: Section, places: Sequence[Place]) -> Rows:
    """A line a row, side by side the noise levels; below the base what it does on the data sets of slower rows."""
    base = section.rows[0]
    pairs = [(row.at(place), base.at(place)) for row in section.rows[1:] for place in places]
    fewer = {cell.n for cell, other in pairs if cell and other and cell.n < other.n} if base.base else set()
    rows: list[tuple[Variant, int | None]] = [(row, None) for row in section.rows]
    rows[1:1] = [(base, n) for n in sorted(fewer, reverse=True)]
    columns: Columns[tuple[Variant, int | None]] = {
        f"{place[0]:g} dB {quantity.heading}": partial(_entry, place, quantity)
        for place in places
        for quantity in ACCURACY.values()
    }
    first: Columns[tuple[Variant, int | None]] = {
        "row": lambda row: _title(row[0]) if row[1] is None else f"the base on {row[1]} data sets",
        "n": lambda row: _counts(places, row[0]) if row[1] is None else str(row[1]),
    }
    return listing(rows, {**first, **columns})


def _entry(place: Place, quantity: FamilyColumn, row: tuple[Variant, int | None]) -> str:
    cell, n = row[0].at(place), row[1]
    shown = cell is not None and (n is None or cell.n > n)
    return quantity.text(quantity.value(cell, n, None)) if cell and shown else MISSING


def _combinations(family: Family) -> list[str | Rows]:
    """The errors of combinations of settings on the same data sets, the values of the second setting side by side."""
    settings, names = family.combinations.settings, family.names
    if len(settings) < 2:
        return []

    def values(variant: Variant) -> dict[str, Any]:
        return {name: variant.settings.get(name, names.usual[name]) for name in settings}

    def order(variant: Variant) -> list[float]:
        own = values(variant)
        return [names.order(name, own[name]) for name in (*settings[:1], *settings[2:], *settings[1:2])]

    def row(variant: Variant) -> Texts:
        return {_words(name): names.of(name, value) for name, value in values(variant).items() if name != settings[1]}

    def entry(variant: Variant) -> Texts:
        cell, text = variant.at(PLACE), MISSING
        if cell:
            errors = (ACCURACY[f"{name}_excess"] for name in (STIFFNESS, DAMPING))
            both = ", ".join(error.text(error.value(cell, n, None)) for error in errors)
            text = f"{both} ({number(finite_median(cell.cpu_s))} s)"
        return {names.of(settings[1], values(variant)[settings[1]]): text}

    combined = [item for variant in family.combinations.rows for item in values(variant).items()]
    ours = [v for v in family.variants if v.method == family.method and set(v.settings) <= set(settings)]
    shown = [variant for variant in ours if all(item in combined for item in values(variant).items())]
    n = min((cell.n for variant in shown if (cell := variant.at(PLACE))), default=0)
    explanation = (
        f"Errors of k/m and c/m over the bound on the first {n} data sets ({PLACE[0]:g} dB, start {PLACE[1]}), and "
        "processor seconds of a whole fit."
    )
    heading = f"## All combinations of {', '.join(map(_words, settings))}"
    return [heading, explanation, Panel(entry, row, order=order).rows(shown)] if shown else []


def _words(setting: str) -> str:
    return setting.replace("_", " ")


# ---- where the rows are from


def _sources(family: Family) -> str:
    """A list: every choice that a row has, then every other package, with the versions that computed the cells."""
    ours = [variant for variant in family.variants if variant.method == family.method]
    lines = []
    for setting, values in cards()[family.method].choices.items():
        for value in values:  # one of another package is loaded only where a row has it
            users = [v for v in ours if v.settings.get(setting, family.names.usual[setting]) == value]
            if users:
                choice = values[value]
                package = f" ({_versions(choice.package, users)})" if choice.package else ""
                lines.append(f"{choice.title}: {choice.source}{package}")
    others = next((section.rows for section in family.sections if section.heading == "Other packages"), ())
    for variant in others:
        method = load_method(variant.method)
        packages = ", ".join(_versions(name, [variant]) for name in method.requires)
        lines.append(f"{variant.title}: {method.card.settings_source}" + (f" ({packages})" if packages else ""))
    return "\n".join(f"- {line}" for line in dict.fromkeys(lines))


def _versions(package: str, users: Iterable[Variant]) -> str:
    """A package with the version that the stored cells were computed with, else with the one that is installed."""
    stored = [cell.stored.provenance.get("packages", {}) for v in users for cell in v.cells.values() if cell.stored]
    names = (package, package.replace("-", "_"))
    known = {str(packages[name]).partition("+")[0] for packages in stored for name in names if name in packages}
    return f"{package} {', '.join(sorted(known)) or _installed(package)}"


@cache
def _installed(package: str) -> str:
    """Return the installed version of a package, named as its distribution is or as it is imported."""
    for name in (package, *packages_distributions().get(package, ())):
        with suppress(PackageNotFoundError):
            return version(name).partition("+")[0]
    return "not installed here"
